"""A board on which all is well, and a protection that is taken from tick to tick over it."""

from fault.fmea import shipped_limits
from fault.limits import Limit
from fault.modes import Cause
from fault.protection import Protection, Raised
from telemetry import dictionary as d
from telemetry.board import Board
from telemetry.declaration import Point
from telemetry.dictionary import MODE_SLOTS, FlightMode

NOTHING = Cause(0)
GOOD: dict[Point, float] = {
    d.CMP: 0.995, d.RECALL: 0.97, d.MATCHED: 250.0, d.REPROJECTION_RMS_PX: 0.02, d.EPIPOLAR_RMS_PX: 0.03,
    d.OBSERVABLE: 1.0, d.ILLUMINATED: 1.0, d.DROP_RATE: 0.0, d.OVERRUN: 0.0, d.BUS_ERRORS: 0.0, d.STORAGE_FAILED: 0.0,
    d.FREE_WHEEL: 0.0, d.TABLES_CORRUPT: 0.0, d.POOL_VIOLATIONS: 0.0, d.LEASES_OUTSTANDING: 0.0, d.TASKS_SILENT: 0.0,
}  # fmt: skip


def limit(point: Point = d.CMP, number: int = 1, **fields: object) -> Limit:
    """A limit that one sample trips and one clears; fields: what differs."""
    values = {"per": "tick", "set_after": 1, "clear_after": 1, "high_red": 1.0, **fields}
    return Limit(number=number, point=point.name, **values)  # type: ignore[arg-type]


def put_estimate(board: Board, tick: int, modes: int = 3, flags: int = 0, hz: float = 0.7) -> None:
    """An estimate as the identification delivers it; hz: of its first mode."""
    for point, value in (
        (d.ESTIMATE_TICK, tick), (d.ESTIMATE_TIME_US, tick * 1000.0), (d.MODE_COUNT, modes), (d.RECORD_SAMPLES, 400.0),
        (d.ESTIMATE_FLAGS, 0.0), (d.OBSERVABLE, 1.0),
    ):  # fmt: skip
        board.set(point, value)
    for slot in range(MODE_SLOTS):
        for point, value in (
            (d.FREQUENCY_HZ, hz * (slot + 1)), (d.FREQUENCY_SIGMA_HZ, 1e-4), (d.DAMPING_RATIO, 0.005),
            (d.DAMPING_RATIO_SIGMA, 1e-4), (d.AMPLITUDE_MM, 10.0), (d.AMPLITUDE_COHERENCE, 0.99),
            (d.IDENTIFIED_FLAGS, flags), (d.FREQUENCY_UNCERTAINTY, 1e-4), (d.FREQUENCY_JUMP, 0.0),
        ):  # fmt: skip
            board.set(point, value if slot < modes else float("nan"), slot)


class Flight:
    """A protection that tracks a wing; all is well unless the board is told otherwise."""

    def __init__(self, limits: list[Limit] | None = None, shadow: list[Limit] | None = None) -> None:
        self.board, self.tick = Board(), 0
        self.protection = Protection(shipped_limits() if limits is None else limits, shadow or [])
        self.raised: list[Raised] = []
        for point, value in GOOD.items():
            self.board.set(point, value)
        self.protection.begin(self.board)
        self.run(causes=Cause.LOCK_FOUND)

    @property
    def mode(self) -> FlightMode:
        return self.protection.mode

    def run(self, ticks: int = 1, causes: Cause = NOTHING, frame: bool = True, new_estimate: bool = False) -> list[str]:
        """So many ticks; gives the names of the events in them."""
        self.raised = []
        for _ in range(ticks):
            self.raised += self.protection.step(self.board, self.tick, causes, frame, new_estimate)
            self.tick += 1
        return [raised.event.name for raised in self.raised]

    def estimate(self, ago: int = 5, **fields: float) -> list[str]:
        """A tick in which an estimate is delivered whose newest frame is so many ticks old."""
        put_estimate(self.board, self.tick - ago, **fields)  # type: ignore[arg-type]
        return self.run(new_estimate=True)

    def set(self, point: Point, value: float, slot: int = 0) -> None:
        self.board.set(point, value, slot)

    def slots(self, point: Point) -> list[float]:
        return [self.board.get(point, slot) for slot in range(point.slots)]

    @property
    def valid(self) -> list[int]:
        """The slots that are marked valid."""
        return [slot for slot, value in enumerate(self.slots(d.VALID)) if value == 1.0]

    @property
    def flags(self) -> list[d.ModeFlag | None]:
        """The flags of each slot; None where it holds no mode."""
        return [None if value != value else d.ModeFlag(int(value)) for value in self.slots(d.FLAGS)]

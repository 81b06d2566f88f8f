"""identify: the displacement history to modes, beside the ticks; its result appears at a fixed later tick."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fault.modes import measures
from fsw.modal.breaks import last_break
from fsw.modal.channels import Channels, chosen
from fsw.modal.pipeline import identify
from fsw.modal.result import Kind, ModalResult, Mode, Options, Record
from fsw.modal.subspace import Subspace
from fsw.modal.tracking import SAME_FREQUENCY, Holders, assign_slots
from fsw.tables.flight import IdentifyTable
from fsw.tasks.estimate_board import show
from fsw.tasks.state import Estimate, State
from telemetry.dictionary import MODE_SLOTS
from telemetry.events import IDENTIFICATION_FAILED
from wingbeat.errors import InputError

NAN = float("nan")
LONG_AGO_NS = -(1 << 62)
LEAST_SHARE = 0.8  # of the measured ticks in which a cell must be measured to take part
LONG_GAP_TICKS = 15  # a cell hidden for longer is left out, if enough cells were not
LEAST_WHOLE = 0.3  # share of the cells that are enough
LOOK_BACK_TICKS = 90  # newest samples that are searched for a break of the motion
_MADE_UP_TICKS = 300  # of motion long enough for a mode to be found in it
UNCONFIRMED = "unconfirmed"  # flag of a mode that was not found before


class Identify:
    """Sets the history aside, identifies on the worker thread, shows the estimate at its delivery."""

    name = "identify"

    def __init__(self, state: State, table: IdentifyTable) -> None:
        self._state, self.table = state, table
        count = state.tracker.grid.count
        self._time_ns = np.zeros(table.history_ticks, np.int64)
        self._time_s: NDArray[np.float64] = np.zeros(table.history_ticks)
        self._xyz_mm = np.zeros((table.history_ticks, count, 3), np.float32)
        self._samples = self._tick = self._taken_ns = 0
        self._result: ModalResult | None = None
        self._failed = False
        self._cells = np.zeros(0, np.int64)
        self._slots: tuple[int, ...] = ()
        self._holders: Holders = (None,) * MODE_SLOTS  # of the slots, after the latest estimate delivered
        self._next_holders: Holders = self._holders
        self._subspace: Subspace | None = None  # of all channels, of the latest estimate delivered
        self._next_subspace: Subspace | None = None
        self._delivered_ns = LONG_AGO_NS
        self._known: list[Mode] = []  # of the latest estimate that had any with nothing against them
        self._since_ns = LONG_AGO_NS  # a sample before this time belongs to a motion that has ended

    @property
    def table(self) -> IdentifyTable:
        """Its table; a new one holds from the next identification on."""
        return self._table

    @table.setter
    def table(self, table: IdentifyTable) -> None:
        self._table = table
        self._options = Options(
            coordinates=table.coordinates,
            block_rows=table.block_rows,
            order=table.order,
            drift_degree=table.drift_degree,
            most_modes=min(table.most_modes, MODE_SLOTS),
            minimum_amplitude=table.minimum_amplitude_mm,
            correlation=table.correlation,
            method=table.method,
            weighting=table.weighting,
        )

    def init(self) -> None:
        """Identify a made-up decay and a made-up stationary response, so that libraries and kernels are ready."""
        t = np.linspace(0.0, 0.1 * _MADE_UP_TICKS, _MADE_UP_TICKS)
        decay = np.exp(-0.05 * t) * np.cos(9.0 * t)
        push = 35.35 * t * t % 1.0 - 0.5  # as good as random
        made_up: dict[Kind, NDArray[np.float64]] = {"decay": decay, "ambient": np.convolve(push, decay)[: len(t)]}
        for kind, y in made_up.items():
            channels = (y[:, None] * np.linspace(0.5, 1.0, 90)).astype(np.float32)
            channels[1, 1] = NAN
            identify(t, channels, kind, self._options, overwrite=True, whole=True)

    def take(self, tick: int) -> bool:
        """Copy the history; False while it is too short, or nothing is measured."""
        state = self._state
        if not measures(state.mode):
            return False
        self._samples = min(len(state.history_time_ns), self._table.history_ticks)
        if self._samples < self._table.least_ticks:
            return False
        state.history_time_ns.copy_latest(self._time_ns[: self._samples])
        state.history_mm.copy_latest(self._xyz_mm[: self._samples])
        self._tick, self._taken_ns = tick, state.time_ns
        return True

    def work(self) -> None:
        """Identify the copied record. A record that no mode can be found in is no reason to stop flying."""
        try:
            self._result, self._failed = self._identify(), False
            self._assign()
        except (InputError, np.linalg.LinAlgError):
            self._result, self._failed = None, True

    def _identify(self) -> ModalResult | None:
        self._next_subspace = None
        time_ns, xyz = self._time_ns[: self._samples], self._xyz_mm[: self._samples]
        if time_ns[-1] < self._since_ns:  # the clock went back
            self._since_ns = LONG_AGO_NS
        # A tick without a pair, or before the lock, says nothing against a cell.
        measured = np.isfinite(xyz[:, :, 0])
        ticks = measured.any(axis=1) & (time_ns >= self._since_ns)
        if np.count_nonzero(ticks) < self._table.least_ticks:
            return None
        if start := self._break(time_ns, xyz, np.flatnonzero(ticks)):
            ticks[:start] = False
            self._since_ns = int(time_ns[start])
        time_ns = time_ns[ticks]
        if start and len(time_ns) < self._table.least_ticks:
            extent = Record(float(time_ns[-1] - time_ns[0]) * 1e-9, len(time_ns), NAN)
            return ModalResult([], ["short_record"], extent, "decay")
        self._cells = cells_to_use(measured[ticks])
        if len(self._cells) == 0:
            return None
        channels = np.repeat(np.isin(np.arange(xyz.shape[1]), self._cells), xyz.shape[2])
        # The copy is used up: nothing of the size of the record is made beside it.
        y = chosen(xyz.reshape(len(xyz), -1), ticks, channels, overwrite=True)
        time_s = self._time_s[: len(y)]
        np.multiply(time_ns - time_ns[0], 1e-9, out=time_s)
        # A record that has nothing in common with the one before begins by itself.
        overlaps = not start and time_ns[0] <= self._delivered_ns
        known = self._subspace.of(channels) if self._subspace is not None and overlaps else None
        result = identify(
            time_s,
            y,
            self._table.kind,
            self._options,
            overwrite=True,
            known=known,
            whole=True,
            after_break=self._has_broken,
        )
        self._next_subspace = result.subspace.among(channels) if result.subspace is not None else None
        return replace(result, modes=[self._with_clock(mode) for mode in result.modes])

    def _assign(self) -> None:
        """Find the slots of the modes, by shapes over all cells; they hold once the estimate is delivered."""
        modes = []
        for mode in self._result.modes if self._result is not None else ():
            shape = np.full(self._xyz_mm.shape[1:], np.nan, np.complex128)
            shape[self._cells] = mode.shape.reshape(-1, 3)
            modes.append(replace(mode, shape=shape.ravel()))
        self._slots, self._next_holders = assign_slots(modes, self._holders)

    def _break(self, time_ns: NDArray[np.int64], xyz: Channels, measured: NDArray[np.int64]) -> int:
        """Index of the first sample after a break of the motion, by what is known of it; 0 if there is none.

        measured: indices of the samples that count.
        """
        if not self._known:
            return 0
        poles = [pole_of(mode) for mode in self._known]
        newest = measured[-LOOK_BACK_TICKS:]
        recent = xyz[newest].reshape(len(newest), -1)
        start = last_break((time_ns[newest] - time_ns[newest[0]]) * 1e-9, recent, poles)
        return int(newest[start]) if start else 0

    @property
    def _has_broken(self) -> bool:
        """Whether a break of the motion is known of."""
        return self._since_ns != LONG_AGO_NS

    @property
    def _settled(self) -> bool:
        """Whether the record is full since the last break. Until then what goes on shaking the wing biases all
        estimates alike: only what was valid before the break confirms a mode, and nothing takes its place.
        """
        samples = self._result.record.samples if self._result is not None else 0
        return not self._has_broken or samples >= self._table.history_ticks

    def _with_clock(self, mode: Mode) -> Mode:
        """The same mode, no surer of its frequency than the clock that times the frames."""
        clock_hz = self._table.clock_tolerance_ppm * 1e-6 * mode.frequency_hz
        return replace(mode, frequency_sigma_hz=math.hypot(mode.frequency_sigma_hz, clock_hz))

    def deliver(self, tick: int) -> None:
        """Show the estimate."""
        state = self._state
        if self._failed:
            state.raise_event(IDENTIFICATION_FAILED, self._samples)
        if self._result is None:
            return
        before = state.estimate
        witnesses = before.result.modes if before is not None and self._settled else []
        modes = confirmed(self._result.modes, [*witnesses, *self._known])
        if self._settled:
            self._known = [mode for mode in modes if mode.valid] or self._known
        self._holders, self._subspace = self._next_holders, self._next_subspace
        self._delivered_ns = self._taken_ns
        result = replace(self._result, modes=modes)
        state.estimate = Estimate(result, self._cells, self._tick, self._taken_ns, self._slots)
        state.new_estimate = True
        show(state, state.estimate, before)


def cells_to_use(measured: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Cells that take part, of what was measured (ticks, cells): those seen in most ticks and, while they are enough,
    never hidden for long. A long gap is filled from the other cells, and worst where all of one end was hidden.
    """
    often = measured.mean(axis=0) >= LEAST_SHARE
    tick = np.arange(len(measured), dtype=np.int32)[:, None]
    seen_last = np.maximum.accumulate(np.where(measured, tick, np.int32(-1)), axis=0)
    whole = often & (np.max(tick - seen_last, axis=0) <= LONG_GAP_TICKS)
    return np.flatnonzero(whole if whole.sum() >= LEAST_WHOLE * often.sum() else often)


def pole_of(mode: Mode) -> complex:
    """A mode's pole in 1/s; of one whose damping is withheld, that of a steady line."""
    omega = 2.0 * math.pi * mode.frequency_hz
    damping = mode.damping_ratio if 0.0 < mode.damping_ratio < 1.0 else 0.0
    return complex(-damping * omega, omega * math.sqrt(1.0 - damping**2))


def confirmed(modes: Sequence[Mode], before: Sequence[Mode]) -> list[Mode]:
    """The same modes; one that was not found before as well, with nothing against it, is flagged.

    Two records in a row have most of their samples in common: what is a mode in one is a mode in the other. What a
    disturbance at the edge of the record feigns is another one each time. before: modes of the estimate before, and
    those that were valid last.
    """
    known = [other.frequency_hz for other in before if set(other.flags) <= {UNCONFIRMED}]
    return [
        mode if any(abs(mode.frequency_hz - hz) < SAME_FREQUENCY * hz for hz in known) else mode.flagged(UNCONFIRMED)
        for mode in modes
    ]

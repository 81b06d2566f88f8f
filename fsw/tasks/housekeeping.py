"""housekeeping: what memory holds is looked after: tables are scrubbed, pools and leases watched, tables activated."""

from collections.abc import Callable, Sequence

from fsw.memory.pool import FramePool
from fsw.tables.bank import TableBank
from fsw.tables.scrub import Scrub
from fsw.tasks.state import State
from telemetry.dictionary import LEASES_OUTSTANDING, POOL_VIOLATIONS, TABLE_REPAIRS, TABLES_CORRUPT, TableFault
from telemetry.events import LEASES_OUTSTANDING as NOT_GIVEN_BACK
from telemetry.events import (
    POOL_VIOLATION,
    TABLE_ACTIVATED,
    TABLE_CORRUPT,
    TABLE_REJECTED,
    TABLE_REPAIRED,
    TableNumber,
)


class Housekeeping:
    """One copy of a table is scrubbed a tick; what concerns other tasks is done when the tick is over.

    apply: makes the application go by the active tables with these numbers.
    """

    name = "housekeeping"

    def __init__(
        self,
        state: State,
        bank: TableBank,
        pools: Sequence[FramePool],
        apply: Callable[[Sequence[TableNumber]], None],
    ) -> None:
        self._state, self._bank, self._pools, self._apply = state, bank, pools, apply
        self._scrub = Scrub(bank)
        self._violations = [0] * len(pools)
        self._replaced: list[TableNumber] = []  # tables in use that the scrub made good in this tick

    def init(self) -> None:
        """Say which tables are active; nothing is damaged yet."""
        state = self._state
        for point in (POOL_VIOLATIONS, LEASES_OUTSTANDING, TABLES_CORRUPT, TABLE_REPAIRS):
            state.board.set(point, 0)
        for number, store in self._bank.stores.items():
            state.raise_event(TABLE_ACTIVATED, number, store.active.version)

    def run(self, tick: int, time_ns: int) -> None:
        """Scrub one copy of a table; look at what was given back to the pools."""
        self._check_table()
        for eye, pool in enumerate(self._pools):
            if pool.violations != self._violations[eye]:
                self._violations[eye] = pool.violations
                self._state.raise_event(POOL_VIOLATION, eye)
        self._state.board.set(POOL_VIOLATIONS, sum(self._violations))

    def reset(self) -> None:
        """Count from 0 again."""
        for pool in self._pools:
            pool.reset()
        self._violations = [0] * len(self._pools)
        self._state.board.set(TABLE_REPAIRS, 0)

    def tick_ends(self, hyperperiod_ends: bool) -> None:
        """After the last task: apply repaired tables, and at the end of a hyperperiod the planned ones."""
        if self._replaced:
            self._apply(self._replaced)
            self._replaced.clear()
        if hyperperiod_ends:
            self._count_leases()
            self._activate()

    def _check_table(self) -> None:
        state, damage = self._state, self._scrub.step()
        if damage is not None:
            state.raise_event(TABLE_CORRUPT, damage.number, damage.which)
            if damage.repaired:
                state.board.add(TABLE_REPAIRS)
                state.raise_event(TABLE_REPAIRED, damage.number, damage.which)
            if damage.in_use:
                self._replaced.append(damage.number)
        state.board.set(TABLES_CORRUPT, len(self._scrub.beyond_repair))

    def _count_leases(self) -> None:
        """All frames have been given back by now."""
        before = self._state.board.get(LEASES_OUTSTANDING)
        count = sum(pool.leased for pool in self._pools)
        self._state.board.set(LEASES_OUTSTANDING, count)
        if count > before:
            self._state.raise_event(NOT_GIVEN_BACK, count)

    def _activate(self) -> None:
        planned = self._bank.pending
        changed, fault = self._bank.at_boundary()
        if changed:
            self._apply(changed)
        for number in changed:
            self._state.raise_event(TABLE_ACTIVATED, number, self._bank.stores[number].active.version)
        if planned is not None and fault is not TableFault.NONE:
            for number in planned.numbers:
                self._state.raise_event(TABLE_REJECTED, number, fault)

"""The numbers of the flight tables as parameters: a name of at most 16 letters each, to read and to set one by one."""

import math
from typing import Any, NamedTuple

import msgspec

from fsw.tables.bank import Pending, TableBank
from fsw.tables.image import KINDS
from telemetry.dictionary import TableFault
from telemetry.events import TableNumber

PREFIXES = {TableNumber.VISION: "V_", TableNumber.IDENTIFY: "I_", TableNumber.EXECUTIVE: "E_"}
LONGEST_NAME = 16


class Parameter(NamedTuple):
    """One number of a table. whole: it takes whole numbers only."""

    name: str
    table: TableNumber
    field: str
    whole: bool


def find_parameters() -> tuple[Parameter, ...]:
    """The numbers of the vision, identify and executive tables, in the tables' order."""
    found = []
    for table, prefix in PREFIXES.items():
        info = msgspec.inspect.type_info(KINDS[table])
        assert isinstance(info, msgspec.inspect.StructType)
        for field in info.fields:
            kind = field.type.type if isinstance(field.type, msgspec.inspect.Metadata) else field.type
            if isinstance(kind, msgspec.inspect.IntType | msgspec.inspect.FloatType):
                name = (prefix + field.name.upper())[:LONGEST_NAME]
                found.append(Parameter(name, table, field.name, isinstance(kind, msgspec.inspect.IntType)))
    return tuple(found)


PARAMETERS = find_parameters()
INDEX_BY_NAME = {parameter.name: index for index, parameter in enumerate(PARAMETERS)}


def parameter_value(bank: TableBank, index: int) -> float:
    """A parameter's value as it holds, or as it will from the next boundary on."""
    _, table, field, _ = PARAMETERS[index]
    return float(getattr(_base(bank, table), field))


def set_parameter(bank: TableBank, index: int, value: float) -> TableFault:
    """Plan a parameter's new value for the next boundary, together with what is planned already.

    BUSY: a table of the ground's is loaded and waits, or tables are to go back. A value in single precision is taken
    as the shortest decimal number that it can stand for.
    """
    _, table, field, whole = PARAMETERS[index]
    pending, store = bank.pending, bank.stores[table]
    planned = pending is not None and table in pending.numbers
    if (pending is not None and pending.back) or (store.loaded is not None and not planned):
        return TableFault.BUSY
    if not math.isfinite(value) or (whole and value != int(value)):
        return TableFault.BAD_VALUE
    given: Any = int(value) if whole else float(f"{value:.7g}")
    fault = bank.offer(table, msgspec.to_builtins(_base(bank, table)) | {field: given})
    if fault is not TableFault.NONE:
        return fault
    numbers = (*(pending.numbers if pending is not None else ()), *(() if planned else (table,)))
    bank.pending = Pending(numbers, back=False)
    return TableFault.NONE


def _base(bank: TableBank, table: TableNumber) -> Any:
    """The table that a change starts from: the one that is to be active from the next boundary on."""
    store, pending = bank.stores[table], bank.pending
    planned = pending is not None and table in pending.numbers and not pending.back
    return store.loaded.table if planned and store.loaded is not None else store.active.table

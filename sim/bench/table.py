"""Rows of a bench as text: one block for each table, one column for each figure that any of its rows has."""

from collections.abc import Sequence

Row = dict[str, str | int | float | None]
FIXED = ("table", "method", "case")


def table_text(rows: Sequence[Row]) -> str:
    """All tables, in the order of their first rows."""
    names = list(dict.fromkeys(str(row["table"]) for row in rows))
    return "\n\n".join(_block(name, [row for row in rows if row["table"] == name]) for name in names)


def _block(name: str, rows: Sequence[Row]) -> str:
    figures = [key for key in dict.fromkeys(key for row in rows for key in row) if key not in FIXED]
    cells = [["method", "case", *figures]]
    cells += [[str(row["method"]), str(row["case"]), *(_text(row.get(key)) for key in figures)] for row in rows]
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    lines = ["  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip() for line in cells]
    return "\n".join([name, *lines])


def _text(value: str | int | float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)

"""The command `wingbeat`: finds the commands that the rooms registered, and loads one when it is called."""

import os
import sys
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import typer

from wingbeat import __version__
from wingbeat.errors import InputError

GROUP = "wingbeat.commands"
PLAIN: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None, "pretty_exceptions_enable": False}


class Commands(typer.core.TyperGroup):
    """The registered commands; importing a room waits until its command is asked for."""

    @staticmethod
    def _registered() -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=GROUP)}

    def list_commands(self, ctx: Any) -> list[str]:
        return sorted(self._registered())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        point = self._registered().get(cmd_name)
        if point is None:
            return None
        app = typer.Typer(**PLAIN)
        app.command(cmd_name)(point.load())
        return typer.main.get_command(app)


app = typer.Typer(
    cls=Commands, add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False
)


@app.callback(invoke_without_command=True)
def _root(version: bool = typer.Option(False, "--version", help="Print the version and stop.")) -> None:
    """Measure a satellite's solar wing with two cameras and tell the attitude controller its modes."""
    if version:
        typer.echo(f"wingbeat {__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point: 0 on success, 1 on failure with one line on stderr, 2 on wrong usage."""
    try:
        app()
    except InputError as error:
        sys.exit(f"wingbeat: error: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        if os.environ.get("WINGBEAT_TRACEBACK"):
            raise
        name = type(error).__name__
        sys.exit(
            f"wingbeat: internal error: {name}: {' '.join(str(error).split())}; "
            "this is a defect of wingbeat: please report it with the output of WINGBEAT_TRACEBACK=1"
        )


if __name__ == "__main__":
    main()

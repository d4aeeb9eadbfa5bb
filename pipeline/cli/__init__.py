"""Command line of everything but training: evaluations, results, demonstrations, films.

A module here holds the arguments and options of a few commands. What does their work is imported
when one of them runs: most of it stands on torch, which takes seconds to load, and help, tables and
refused arguments need none of it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

import typer

from envs.pictures import RenderingUnavailableError
from envs.task import TaskFailedError
from pipeline.cli.demonstrations import demos_check, record
from pipeline.cli.films import play, strip, video
from pipeline.cli.judging import evaluate, robust
from pipeline.cli.results import plot, report, results, table
from pipeline.cli.settings import settings
from pipeline.files.full_disk import with_remedy
from pipeline.non_finite import EXIT_CODE, NonFiniteError

COMMANDS: Final[Mapping[str, Callable[..., None]]] = MappingProxyType(
    {
        "eval": evaluate,
        "robust": robust,
        "settings": settings,
        "table": table,
        "results": results,
        "plot": plot,
        "report": report,
        "demos-check": demos_check,
        "record": record,
        "video": video,
        "strip": strip,
        "play": play,
    }
)
"""What they run, by their names, in the order of the help."""
USER_ERRORS: Final = (ImportError, RenderingUnavailableError, TaskFailedError, ValueError)
"""What a user can do something about; most errors of ours are a ``ValueError``."""

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)
for _name, _command in COMMANDS.items():
    app.command(_name)(_command)


def main() -> None:
    """Runs the command line; user errors become one line and exit code 1 (3: not finite)."""
    try:
        app()
    except NonFiniteError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(EXIT_CODE)
    except OSError as error:
        sys.exit(f"error: {with_remedy(error)}")
    except USER_ERRORS as error:
        sys.exit(f"error: {error}")

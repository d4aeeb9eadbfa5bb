"""Pictures of the results as files."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

from pipeline.files.run_files import write_atomically

DPI = 90


def save_figure(figure: Figure, path: Path) -> None:
    """Writes a figure whole or not at all, in the format that the end of its name says (PNG).

    Raises:
        ValueError: If there is no such format.
        OSError: If it cannot be written; what was there stays.
    """
    picture = io.BytesIO()
    figure.savefig(picture, dpi=DPI, format=path.suffix.removeprefix(".") or "png")
    write_atomically(path, picture.getvalue())

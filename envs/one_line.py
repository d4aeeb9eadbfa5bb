"""What somebody else's exception says, in one line of a message."""

from __future__ import annotations


def text_of(error: BaseException | str) -> str:
    """The text alone, of exceptions whose kind says no more."""
    return " ".join(str(error).split())


def kind_and_text(error: BaseException, most: int | None = None) -> str:
    """``KeyError: 'x'``.

    Args:
        error: What was raised.
        most: Characters of the text that are shown; None shows all.
    """
    text = text_of(error)
    if most is not None and len(text) > most:
        text = f"{text[:most]}..."
    return f"{type(error).__name__}: {text}".rstrip()

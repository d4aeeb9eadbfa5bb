"""How the settings of terms are checked."""

from __future__ import annotations

from typing import Any


class SettingError(ValueError):
    """A setting is out of its range; the message has its name, its range and its value.

    Attributes:
        name: of the setting, as the class that refuses it calls it.
        expected: its range, to complete the sentence "NAME must be ...".
        value: what was given.
    """

    def __init__(self, name: str, expected: str, value: Any) -> None:
        super().__init__(name, expected, value)
        self.name, self.expected, self.value = name, expected, value

    def __str__(self) -> str:
        return f"{self.name} must be {self.expected}, got {self.value!r}"

    def renamed(self, name: str) -> SettingError:
        """Return the same error for a caller who knows the setting by another name."""
        return SettingError(name, self.expected, self.value)


def require(name: str, value: Any, holds: bool, expected: str) -> None:
    """Raise :class:`SettingError` naming the setting unless ``holds``."""
    if not holds:
        raise SettingError(name, expected, value)

"""The one error that every demonstration source raises."""

from __future__ import annotations


class DemonstrationError(ValueError):
    """A demonstration source is missing, unreadable, unsafe or does not fit the task.

    The message always has three parts: where (file and episode), what is wrong (key and value), and
    what to do about it.
    """

    def __init__(self, where: object, problem: str, remedy: str) -> None:
        super().__init__(f"{where}: {problem}. {remedy}")
        self.where = str(where)
        self.problem = problem
        self.remedy = remedy

"""One server for the commands of all tutorials of a worker."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.docs.shell import Shell


@pytest.fixture(scope="session")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    made = Shell(tmp_path_factory.mktemp("shell"))
    yield made
    made.close()

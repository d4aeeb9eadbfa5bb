"""``make smoke`` fails where a variant does, names it, and runs the others."""

from __future__ import annotations

import pytest

from tests import smoke

TOY, SHORT = "tests/toys/reach.py", "collector.total_frames=200"


@pytest.mark.slow
def test_a_variant_that_fails_is_named_and_the_others_run(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match=r"^make smoke: nosuch failed$"):
        smoke.main(["nosuch", "sac", "--jobs=1", "--episodes=2", f"--task={TOY}", "--", SHORT])
    printed = capsys.readouterr().out
    refused, trained = printed.split("==== smoke: nosuch failed")
    assert "there is no variant nosuch" in refused
    assert "evaluation.json\n==== smoke: sac took" in trained

"""Numbers so small that something rounds to nothing or divides by nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.data.demonstrations import Demonstrations
from tests.pipeline.toys import built, tagged_rows, tiny_config


def test_a_share_of_demonstrations_below_a_row_is_named(tmp_path: Path, demos: Path):
    """0.05 of 8 rows are 0.4, which round to 0: plain SAC under another name."""
    config = tiny_config("dbc_sac", tmp_path, demos, "sampler.demo_ratio=0.05")
    with pytest.raises(ValueError, match=r"demo_ratio \(0\.05\).*batch_size \(8\).*at least 0\.12"):
        built(config)


def test_a_single_demonstrated_row_has_no_deviation():
    one = Demonstrations(
        tagged_rows(3.0, 1), None, content_hash="", source="", saturated_share=0.0,
        success_share=None,
    )  # fmt: skip
    assert one.normalizer().std.isfinite().all()
    assert (one.normalizer()(tagged_rows(3.0, 1)["observation"]) == 0).all()

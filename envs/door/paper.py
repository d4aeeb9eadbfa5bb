"""The paper's Tables I and II: 1,000 doors, one run for each row."""

from __future__ import annotations

from typing import Final

from envs.reference import Column, Reference

TABLE_1: Final = (
    Column("return_mean", "return"),
    Column("angle_mean_deg", "angle (deg)"),
    Column("angle_mean_deg_opened", "opened only"),
)
TABLE_2: Final = (
    Column("share_gt_0", "> 0 rad", percent=True),
    Column("share_gt_0_2", "> 0.2", percent=True),
    Column("share_gt_1_0", "> 1.0", percent=True),
    Column("share_gt_1_35", "> 1.35 once", percent=True),
)
HELD: Final = (
    Column("success_at_end", "at the end", percent=True),
    Column("success_dapg", "> 25 steps", percent=True),
)
"""Behind Table II, which counts a door that passes an angle once: doors that are still open at the
last step, and doors that were for more than 25 steps, as DAPG counts. The paper has neither."""
_KEYS: Final = tuple(column.key for column in (*TABLE_1, *TABLE_2))
_ROWS: Final[dict[str, tuple[float, ...]]] = {
    "sac": (4.1, 2.2, 12.3, 0.182, 0.049, 0.010, 0.002),
    "bc": (461.0, 41.1, 55.9, 0.736, 0.648, 0.349, 0.276),
    "bc_sac_0.1": (65.3, 7.9, 51.1, 0.155, 0.118, 0.101, 0.0),
    "bc_sac_1": (955.8, 83.1, 84.0, 0.989, 0.975, 0.925, 0.839),
    "bc_sac_10": (868.8, 77.7, 81.3, 0.956, 0.938, 0.881, 0.780),
    "dbc_sac": (966.7, 86.4, 86.5, 0.999, 0.993, 0.982, 0.948),
    "sid_bc": (910.7, 82.0, 82.7, 0.991, 0.990, 0.982, 0.935),
    "sid_dbc": (966.8, 86.7, 86.7, 1.0, 1.0, 0.999, 0.971),
    "ila_bc": (704.5, 62.1, 62.3, 0.966, 0.951, 0.425, 0.361),
    "ila_dbc": (614.0, 54.3, 56.2, 0.997, 0.962, 0.555, 0.420),
    "da_sac": (46.0, 5.2, 11.0, 0.479, 0.117, 0.008, 0.0),
}

PAPER: Final = Reference(
    source="paper",
    tables={
        "Table I: return and largest door angle": TABLE_1,
        "Table II: share of doors opened beyond": (*TABLE_2, *HELD),
    },
    rows={name: dict(zip(_KEYS, figures, strict=True)) for name, figures in _ROWS.items()},
    success="share_gt_1_35",
)
"""BC-SAC by lambda too: rows of a variant with several imitation weights are ``variant_weight``."""

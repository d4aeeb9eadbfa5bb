"""Merging of the result file, the bars, the Markdown and the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks import bars, cli, machine, report, results
from benchmarks.effort import Effort
from benchmarks.worker import Timing

HERE = {"cpu": "abacus", "cores": 2, "flags": {"amx": False}, "python": "3", "versions": {"x": "1"}}


def test_a_section_replaces_its_own_part_only():
    old = {"machine": HERE, "update": {"a": 1}, "roofline": {"b": 2}}
    merged = results.merge(old, {"update": {"c": 3}}, HERE)
    assert merged == {"machine": HERE, "update": {"c": 3}, "roofline": {"b": 2}}


def test_results_of_another_machine_are_not_mixed_in():
    with pytest.raises(results.ResultsError, match=r"another cores.*no --section"):
        results.merge({"machine": HERE}, {}, {**HERE, "cores": 4})


@pytest.mark.parametrize("text", ["{", "[1]"])
def test_a_damaged_file_is_named(tmp_path: Path, text: str):
    path = tmp_path / results.JSON_NAME
    path.write_text(text)
    with pytest.raises(results.ResultsError, match=r"latest\.json"):
        results.load(path)


def test_a_missing_file_holds_nothing(tmp_path: Path):
    assert results.load(tmp_path / "none.json") == {}


def test_bars_compare_in_their_direction():
    measured = {
        "update": {"256": {"ours_bc_sac": 4.0, "sb3": 12.0, "sbx": 5.0}},
        "rlpd_frame": {"ours": 150.0, "ratio": 2.9},
    }
    found = {bar["what"]: (bar["measured"], bar["met"]) for bar in bars.evaluate(measured)}
    assert found["bc_sac 256x256/B256: times faster than sb3's SAC"] == (3.0, True)
    assert found["bc_sac 256x256/B256: times faster than sbx's SAC"] == (1.25, False)
    assert found["RLPD-sized frame: ms"] == (150.0, True)
    assert found["RLPD-sized frame: times faster than torchrl's REDQLoss"] == (2.9, False)
    assert found["dbc_sac, paper preset, 100,000 frames: hours"] == (None, None)


def test_an_update_block_reports_the_fastest_way_and_its_share():
    from benchmarks import ours, roofline, update

    ways = [f"ours_{v}_{p}" for v in update.VARIANTS for p in ours.PRECISIONS]
    seconds = dict.fromkeys([*ways, "sb3", "sbx_single", "sbx_looped", "torchrl"], 0.010)
    seconds |= {"ours_bc_sac_fp32": 0.004, "sb3": 0.012, "sbx_looped": 0.006}
    timings = {name: Timing([s, s, s], 100.0) for name, s in seconds.items()}
    # 100 GFLOP/s in fp32 and 200 in bf16.
    for size in roofline.SIZES:
        timings[f"gemm_fp32_{size}_2"] = Timing([1e-11], 1.0)
        timings[f"gemm_bf16_{size}_2"] = Timing([5e-12], 1.0)
    block = update.summarise(timings, 256, 256, threads=2)
    assert (block["ours_bc_sac"], block["sb3"], block["sbx"]) == (4.0, 12.0, 6.0)
    assert block["fastest"]["sbx"] == "sbx_looped"
    assert block["ratios"]["sb3/ours_bc_sac"] == 3.0
    assert block["ceilings_gflops"] == {"fp32": 100.0, "bf16": 200.0}
    share = block["roofline"]["ours_bc_sac_fp32"]
    assert share["of_own_precision"] == pytest.approx(2 * share["of_fastest"], rel=0.01)
    # The imitation term's rows cost the actor's passes, which plain SAC does not have.
    assert share["gflop"] > block["roofline"]["sb3"]["gflop"]


def test_the_report_is_rendered_from_what_is_there():
    content = {
        "machine": HERE,
        "bars": bars.evaluate({}),
        "roofline": {"quick": True, "threads": [1], "gflops": {"1": {"fp32": 160.0, "bf16": 84.0}}},
    }
    text = report.render(json.loads(json.dumps(content)))
    assert "not to be quoted" in text
    assert "| 1         | 160    | 84     |" in text
    assert "not measured" in text
    assert "Growth" not in text


def test_two_generations_of_one_name_are_two_machines(tmp_path: Path):
    described = []
    for model in (17, 2):
        path = tmp_path / "cpuinfo"
        path.write_text(f"cpu family\t: 25\nmodel\t\t: {model}\nmodel name\t: Abacus\n")
        described.append(machine.describe(path))
    one, other = described
    assert one["cpu"] == other["cpu"] == "Abacus"
    with pytest.raises(results.ResultsError, match="cpu_model"):
        results.merge({"machine": one}, {}, other)
    assert "Abacus (cpu family 25, model 17" in report.render({"machine": one})


def test_the_machine_is_described_without_its_name():
    text = json.dumps(machine.describe())
    assert "/" not in text.replace(json.dumps(machine.describe()["cpu"]), "")
    assert Path("/proc/sys/kernel/hostname").read_text().strip() not in text


def test_one_section_writes_both_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def section(effort: Effort) -> dict:
        return {"memory_detail": effort.as_json(default={"peak_mib": 12.0})}

    monkeypatch.setattr(cli, "SECTIONS", {"memory": section})
    done = CliRunner().invoke(cli.app, ["--section", "memory", "--quick", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "latest.json").read_text())["memory_detail"]["quick"] is True
    assert "peak_mib 12" in (tmp_path / "latest.md").read_text()


def test_an_unknown_section_is_named():
    done = CliRunner().invoke(cli.app, ["--section", "speed"])
    assert done.exit_code == 2
    assert "unknown section speed; known: roofline" in done.output


def test_the_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cli, "NEEDS_EXTRA", {"update": ("json", "no_such_package")})
    done = CliRunner().invoke(cli.app, ["--section", "update"])
    assert done.exit_code == 2
    assert "error: no_such_package not installed" in done.output
    assert "make bench" in done.output
    assert "pip install -e .[bench]" in done.output

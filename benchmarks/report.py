"""The result file as Markdown tables; nothing here measures or recalculates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from tabulate import tabulate

Results = Mapping[str, Any]

INTRODUCTION = """\
# Benchmarks

Written by `make bench` from `latest.json`. Medians over rounds that visit every contestant in turn,
each in a process of its own; quartiles are in brackets where a table has them."""


def render(results: Results) -> str:
    """The whole report; sections that were not measured are left out."""
    parts = [INTRODUCTION]
    for key, title, body in TABLES:
        if results.get(key) is not None:
            parts.append(f"## {title}\n\n{body(results)}")
    return "\n\n".join(parts) + "\n"


def _table(rows: Iterable[Iterable[Any]], headers: Iterable[str]) -> str:
    return tabulate(
        list(rows), list(headers), tablefmt="github", missingval="-", disable_numparse=True
    )


def _number(value: Any) -> str:
    """Four significant digits, without an exponent."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (int, float)):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
    return "-" if value is None else str(value)


def _spread(values: Mapping[str, Any]) -> str:
    low, high = _number(values["quartile_1"]), _number(values["quartile_3"])
    return f"{_number(values['median'])} [{low}, {high}]"


def _conditions(block: Mapping[str, Any]) -> str:
    threads = block["threads"]
    named = ", ".join(map(str, threads)) if isinstance(threads, list) else str(threads)
    words = [f"Threads: {named}."]
    if "precision" in block:
        words.append(f"Precision: {block['precision']}.")
    if block["quick"]:
        words.append("**Quick run: not to be quoted.**")
    return " ".join(words)


def _machine(results: Results) -> str:
    machine = results["machine"]
    flags = [name for name, present in machine["flags"].items() if present]
    versions = ", ".join(f"{name} {v}" for name, v in machine["versions"].items() if v)
    model = f" ({machine['cpu_model']})" if "cpu_model" in machine else ""
    return (
        f"{machine['cpu']}{model}, {machine['cores']} cores, "
        f"{', '.join(flags) or 'no wide vectors'}; "
        f"Python {machine['python']}; {versions}."
    )


def _bars(results: Results) -> str:
    words = {True: "yes", False: "**no**", None: "not measured"}
    rows = [
        (bar["what"], bar["wanted"], _number(bar["measured"]), words[bar["met"]])
        for bar in results["bars"]
    ]
    return _table(rows, ["bar", "wanted", "measured", "met"])


def _update(results: Results) -> str:
    update = results["update"]
    parts = [
        f"{_conditions(update)} ms per update, sampling included; precision by name, the packages "
        "in fp32. `ours_bc_sac` adds as many demonstration rows to the batch as it has replay "
        "rows and draws 16 batches together (4 at 1024), `_single` each by itself; `_eager` is not "
        "compiled; `_mixed` has the default preset's rows, half of the batch demonstrations."
    ]
    for size in ("256", "1024"):
        block = update[size]
        rows = []
        for name, values in block["detail"].items():
            share = block["roofline"][name]
            to_ours = float(values["median"]) / block["ours_bc_sac"]
            rows.append(
                (
                    name,
                    _spread(values),
                    f"{to_ours:.2f}",
                    _number(share["gflops"]),
                    f"{share['of_own_precision']:.0%}",
                    f"{share['of_fastest']:.0%}",
                )
            )
        ceilings = ", ".join(f"{k} {_number(v)}" for k, v in block["ceilings_gflops"].items())
        parts.append(f"### {size}x{size}, batch {block['batch']}\n\nCeilings, GFLOP/s: {ceilings}.")
        headers = ["contestant", "ms", "times ours_bc_sac", "GFLOP/s", "of own ceiling", "of best"]
        parts.append(_table(rows, headers))
    return "\n\n".join(parts)


def _roofline(results: Results) -> str:
    block = results["roofline"]
    rows = [(threads, *map(_number, c.values())) for threads, c in block["gflops"].items()]
    return f"{_conditions(block)} GFLOP/s.\n\n" + _table(rows, ["threads", "fp32", "bf16"])


def _environment(results: Results) -> str:
    block = results["env_steps_detail"]
    raw = results["env_steps_per_s"]["raw_threads_1"]
    rows = [
        (name, _spread(v), f"{float(v['median']) / raw:.2f}", _number(v["peak_mib"]))
        for name, v in block["contestants"].items()
    ]
    headers = ["contestant", "steps/s", "times raw", "peak MiB"]
    return f"{_conditions(block)}\n\n" + _table(rows, headers)


def _pairs(key: str, *, leave_out: tuple[str, ...] = ()) -> Callable[[Results], str]:
    """A table of the plain values of a block."""

    def body(results: Results) -> str:
        block = results[key]
        hidden = {"quick", "threads", "precision", "detail", *leave_out}
        rows = []
        for name, value in block.items():
            if name in hidden or isinstance(value, list):
                continue
            if isinstance(value, Mapping):
                shown = _spread(value) if "median" in value else None
                plain = {k: v for k, v in value.items() if not isinstance(v, Mapping)}
                shown = shown or ", ".join(f"{k} {_number(v)}" for k, v in plain.items())
            else:
                shown = _number(value)
            rows.append((name, shown))
        return f"{_conditions(block)}\n\n" + _table(rows, ["", ""])

    return body


def _breakdown(results: Results) -> str:
    block = results["train_breakdown"]
    parts = block.get("parts_s", {})
    text = _pairs("train_breakdown", leave_out=("parts_s", "share"))(results)
    if not parts:
        return text
    rows = [
        (name, _number(s), f"{block['share'][name]:.1%}")
        for name, s in sorted(parts.items(), key=lambda part: -part[1])
    ]
    return text + "\n\n" + _table(rows, ["part", "s", "share"])


def _scaling(results: Results) -> str:
    block = results["scaling"]
    rows = [
        (axis, value, _number(point["ms_per_update"]), _number(point["peak_mib"]))
        for axis in block["base"]
        if axis in block
        for value, point in block[axis].items()
    ]
    base = ", ".join(f"{name} {_number(value)}" for name, value in block["base"].items())
    table = _table(rows, ["axis", "value", "ms per update", "peak MiB"])
    return f"{_conditions(block)} {block['variant']}, one value changed at a time from: {base}." + (
        f"\n\n{table}"
    )


TABLES: tuple[tuple[str, str, Callable[[Results], str]], ...] = (
    ("machine", "Machine", _machine),
    ("bars", "Bars", _bars),
    ("update", "Updates", _update),
    ("roofline", "Matrix products", _roofline),
    ("env_steps_per_s", "Environment steps per second", _environment),
    ("train_breakdown", "`make train`, default preset", _breakdown),
    ("evaluation_1000", "Evaluation", _pairs("evaluation_1000")),
    ("memory_detail", "Peak memory", _pairs("memory_detail")),
    ("paper_preset", "The paper's preset", _pairs("paper_preset")),
    ("rlpd_frame", "An RLPD-sized frame", _pairs("rlpd_frame")),
    ("scaling", "Growth", _scaling),
)

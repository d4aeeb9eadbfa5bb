"""What the measurements were made on: hardware and versions, nothing that names the machine."""

from __future__ import annotations

import importlib.metadata
import platform
from pathlib import Path
from typing import Any

from benchmarks.worker import available_cores

FLAGS = ("avx2", "avx512f", "avx512_bf16", "amx_bf16", "amx_tile")
PACKAGES = (
    *("torch", "torchrl", "tensordict", "mujoco", "gymnasium-robotics", "numpy"),
    *("stable-baselines3", "sbx-rl", "jax"),
)


CPU_MODEL = ("cpu family", "model", "stepping")
"""What tells processors of one name apart: a virtual machine may call two generations the same."""


def describe(cpuinfo: Path = Path("/proc/cpuinfo")) -> dict[str, Any]:
    """Processor, cores, instruction sets and versions.

    Args:
        cpuinfo: Where Linux lists the processors.
    """
    lines = cpuinfo.read_text().splitlines()
    facts = dict(part.split(":", 1) for part in lines if ":" in part)
    cpu = {name.strip(): value.strip() for name, value in facts.items()}
    flags = set(cpu.get("flags", "").split())
    return {
        "cpu": cpu.get("model name", platform.processor() or platform.machine()),
        "cpu_model": ", ".join(f"{name} {cpu.get(name, '?')}" for name in CPU_MODEL),
        "cores": available_cores(),
        "flags": {flag: flag in flags for flag in FLAGS},
        "python": platform.python_version(),
        "versions": {package: _version(package) for package in PACKAGES},
    }


def _version(package: str) -> str | None:
    try:
        # Without the build tag: it names an index, not what was measured.
        return importlib.metadata.version(package).split("+")[0]
    except importlib.metadata.PackageNotFoundError:
        return None

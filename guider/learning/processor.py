"""The processor at hand, and which precision of matrix products it is fastest in."""

from __future__ import annotations

import platform
from functools import cache
from pathlib import Path

import jax

from guider.learning.networks import Precision, Products

_CPU = Path("/proc/cpuinfo")
_FIRST_GPU_WITH_BFLOAT16 = (8, 0)
"""Compute capability: NVIDIA Ampere."""


def settled(precision: Precision) -> Products:
    """What `auto` means here: bfloat16 where it is multiplied faster than float32, float32 elsewhere."""
    if precision != "auto":
        return precision
    return "bfloat16" if multiplies_bfloat16() else "float32"


@cache
def multiplies_bfloat16() -> bool:
    """Whether bfloat16 products are faster than float32's: on TPUs, GPUs from Ampere on, CPUs with AMX (elsewhere 1.3
    to 1.5 times slower was measured)."""
    backend = jax.default_backend()
    if backend != "gpu":
        return backend == "tpu" or "amx_bf16" in _cpu_facts().get("flags", "").split()
    capability = getattr(jax.devices()[0], "compute_capability", "0.0")
    return tuple(int(number) for number in capability.split(".")) >= _FIRST_GPU_WITH_BFLOAT16


def describe() -> str:
    """The processor that trains, by name, and the precision that `auto` means on it."""
    devices = jax.devices()
    name = (_cpu_facts().get("model name") or platform.processor() or platform.machine()).strip()
    if jax.default_backend() != "cpu":
        name = f"{len(devices)} x {devices[0].device_kind}"
    return f"{name} ({settled('auto')} products)"


def _cpu_facts() -> dict[str, str]:
    """What the kernel says of the first core; nothing where it says nothing (not Linux)."""
    try:
        first, *_ = _CPU.read_text().split("\n\n")
    except OSError:
        return {}
    lines = (line.partition(":") for line in first.splitlines())
    return {name.strip(): value.strip() for name, _, value in lines}

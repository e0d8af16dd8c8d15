"""What `auto` means on processors other than this one."""

from types import SimpleNamespace

import jax
import pytest

from guider.learning import processor


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """machine(backend, flags, capability) puts the tests on another one."""

    def become(backend: str, flags: str = "", capability: str = "") -> None:
        (tmp_path / "cpuinfo").write_text(
            f"processor\t: 0\nmodel name\t: Made Up 7\nflags\t\t: {flags}\n\nprocessor\t: 1\n"
        )
        device = SimpleNamespace(device_kind="Made Up GPU", compute_capability=capability)
        monkeypatch.setattr(processor, "_CPU", tmp_path / "cpuinfo")
        monkeypatch.setattr(jax, "default_backend", lambda: backend)
        monkeypatch.setattr(jax, "devices", lambda: [device])
        processor.multiplies_bfloat16.cache_clear()

    yield become
    processor.multiplies_bfloat16.cache_clear()


@pytest.mark.parametrize(
    ("there", "precision"),
    [
        (("cpu", "sse avx512_bf16 amx_bf16 amx_tile"), "bfloat16"),
        (("cpu", "sse avx512f avx512_bf16"), "float32"),
        (("tpu",), "bfloat16"),
        (("gpu", "amx_bf16", "9.0"), "bfloat16"),
        (("gpu", "amx_bf16", "8.0"), "bfloat16"),
        (("gpu", "amx_bf16", "7.5"), "float32"),
        (("gpu", "amx_bf16", "10.0"), "bfloat16"),
    ],
)
def test_auto_is_what_the_processor_multiplies_fastest(machine, there, precision):
    machine(*there)
    assert processor.settled("auto") == precision
    assert processor.settled("float32") == "float32" and processor.settled("bfloat16") == "bfloat16"
    assert f"({precision} products)" in processor.describe()
    assert ("1 x Made Up GPU" if there[0] == "gpu" else "Made Up") in processor.describe()


def test_where_the_kernel_says_nothing_auto_is_float32(machine, tmp_path):
    machine("cpu", "amx_bf16")
    (tmp_path / "cpuinfo").unlink()
    assert processor.settled("auto") == "float32"

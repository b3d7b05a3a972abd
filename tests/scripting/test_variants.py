"""Variants as scripts use them: questions, modules of one variant, blocks."""

from __future__ import annotations

import pytest

import djpt
from djpt.errors import BackendError
from tests.kit.processes import run_python


def test_what_a_script_asks() -> None:
    answers = (djpt.is_rgb, djpt.is_spectral, djpt.is_monochromatic, djpt.is_polarized)
    assert answers == (True, False, False, False)


@pytest.mark.parametrize("form", ["variant_context", "scoped_set_variant"])
def test_a_variant_for_a_block(form: str) -> None:
    with getattr(djpt, form)("llvm_ad_rgb"):
        assert djpt.variant() == "llvm_ad_rgb"
    with pytest.raises(BackendError), getattr(djpt, form)("llvm_ad_spectral"):
        pass
    assert djpt.variant() == "llvm_ad_rgb"


@pytest.mark.parametrize("name", ["llvm_ad_rgb", "scalar_rgb", "cuda_ad_rgb", "python"])
@pytest.mark.sparse(2)
def test_a_module_of_one_variant_is_djpt(name: str) -> None:
    code = f"""
import djpt
import djpt.{name}
import djpt.{name} as mi
from djpt.{name} import Float
from djpt import {name}
print(mi is djpt, {name} is djpt, Float is djpt.Float, djpt.{name} is djpt)
"""
    done = run_python("-c", code)
    assert done.stdout == "True True True True\n", done.stderr

"""The closed forms that users run: data in order, right integrators pass, wrong ones fail."""

import pytest

import djpt
from djpt.validation.closed_forms import CASES, validate
from tests.kit.commands import run


def test_there_are_enough() -> None:
    assert len(CASES) >= 12
    for case in CASES.values():
        assert case.formula and case.source and case.radiance > 0 and case.integrators
        assert "integrator" not in case.scene()


@pytest.mark.sparse(12)
@pytest.mark.parametrize("name", CASES)
def test_path_tracers(name: str) -> None:
    outcomes = list(validate([CASES[name]], ["path", "volpath"], spp=256))
    assert outcomes
    assert all(outcome.passed for outcome in outcomes), outcomes


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_all_integrators(name: str) -> None:
    outcomes = list(validate([CASES[name]], spp=4096))
    assert {outcome.integrator for outcome in outcomes} == set(CASES[name].integrators)
    assert all(outcome.passed for outcome in outcomes), outcomes


def test_a_wrong_integrator_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    eval_pdf = djpt.materials.Diffuse.eval_pdf

    def brighter(self: object, *args: object) -> object:
        value, pdf = eval_pdf(self, *args)
        return 1.01 * value, pdf

    monkeypatch.setattr(djpt.materials.Diffuse, "eval_pdf", brighter)
    (outcome,) = validate([CASES["point light"]], ["path"], spp=16)
    assert not outcome.passed and outcome.relative == pytest.approx(0.01, rel=0.1)


def test_the_command_line() -> None:
    code, out, err = run("validate", "point light", "sunlight", "--integrator", "path", "--spp", "16")
    assert code == 0, err
    assert "2 of 2 are right" in out
    code, _, err = run("validate", "point lite")
    assert code == 2 and "point light" in err
    code, _, err = run("validate", "--integrator", "pth")
    assert code == 2 and "path" in err

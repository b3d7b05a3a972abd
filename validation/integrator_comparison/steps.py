"""The steps of the ladder: the integrators that estimate the light of a scene, and the light that each can't show."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from djpt.core.records import BSDFFlags, EmitterFlags, has_flag

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["ELSEWHERE", "STEPS", "Step"]

SHARED: dict[str, Any] = {"max_depth": -1, "rr_depth": 5, "hide_emitters": False, "emitter_choice": "uniform"}
"""Settings that a step takes over from the scene's integrator, if both have them, and their defaults."""


def has_points(scene: Scene) -> bool:
    """True if a scene has lights that no path meets by chance, such as points."""
    return any(has_flag(emitter.flags(), EmitterFlags.Delta) for emitter in scene.emitters())


def has_mirrors(scene: Scene) -> bool:
    """True if a scene has mirrors or smooth panes."""
    mirrors = BSDFFlags.DeltaReflection | BSDFFlags.DeltaTransmission
    return any(has_flag(bsdf.flags(), mirrors) for bsdf in scene.bsdfs.plugins)


def has_caustics_of_points(scene: Scene) -> bool:
    """True if a scene has both: lights that no path meets by chance, and mirrors or smooth panes."""
    return has_points(scene) and has_mirrors(scene)


@dataclass(frozen=True)
class Step:
    """One integrator with its settings."""

    title: str
    type: str
    idea: str
    """The idea of the algorithm, in one sentence."""
    leaves_out: str
    """The light that its images never show, at any number of samples; empty: none."""
    shares: tuple[str, ...]
    """The settings of `SHARED` that the integrator has."""
    matters: Callable[[Scene], bool] = lambda scene: True
    """True if a scene has the light that the step leaves out: by default any."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    deepest: int | None = None
    """Most edges of its paths on the ladder, though longer ones are possible; None: as many as the scene asks for."""

    def description(self, scene: Scene) -> dict[str, Any]:
        """The integrator as a dict, for `load_dict`; as deep as the scene's own integrator, or as `deepest` allows."""
        own = scene.integrator()
        shared = {key: getattr(own, key, SHARED[key]) for key in self.shares}
        if "max_depth" in shared:
            shared["max_depth"] = self.depth(shared["max_depth"])
        return {"type": self.type, **shared, **self.settings}

    def depth(self, wanted: int) -> int:
        """The edges of the longest path if `wanted` are asked for; -1: unbounded."""
        if self.deepest is None:
            return wanted
        return self.deepest if wanted < 0 else min(wanted, self.deepest)

    def missing(self, scene: Scene) -> str:
        """The light of a scene that its images don't show; empty: none."""
        wanted = getattr(scene.integrator(), "max_depth", -1)
        short = f"paths of more than {self.deepest} edges" if self.depth(wanted) != wanted else ""
        other = self.leaves_out if self.matters(scene) else ""
        return " and ".join(text for text in (short, other) if text)


HIDE, DEPTH, ROULETTE, CHOICE = "hide_emitters", "max_depth", "rr_depth", "emitter_choice"

STEPS: tuple[Step, ...] = (
    Step(
        "raycast",
        "raycast",
        "The first surface along each ray, as if lit by a lamp at the eye.",
        "lights, shadows, reflections, indirect light",
        (HIDE,),
    ),
    Step(
        "whitted",
        "whitted",
        "Mirrors and panes are followed; all else is lit by lamps that are points.",
        "soft shadows, blurred reflections, caustics, indirect light, light of an environment on surfaces",
        (DEPTH, HIDE),
        deepest=16,
    ),
    Step(
        "direct",
        "direct",
        "Light that comes straight from emitters, by two sampling strategies.",
        "indirect light, and what mirrors and glass show of it",
        (HIDE, CHOICE),
    ),
    Step(
        "distributed",
        "distributed",
        "At every surface four rays go on and four go to the lights.",
        "",
        (DEPTH, HIDE, CHOICE),
        deepest=3,
    ),
    Step(
        "path_naive, uniform",
        "path_naive",
        "Paths in uniform directions, until one meets a light.",
        "light of point, spot and directional lamps",
        (DEPTH, ROULETTE, HIDE),
        has_points,
        {"hemisphere": "uniform"},
    ),
    Step(
        "path_naive, cosine",
        "path_naive",
        "Directions by the cosine: those that count more come more often.",
        "light of point, spot and directional lamps",
        (DEPTH, ROULETTE, HIDE),
        has_points,
        {"hemisphere": "cosine"},
    ),
    Step(
        "prb_basic",
        "prb_basic",
        "Directions by the material; no roulette.",
        "light of point, spot and directional lamps",
        (DEPTH, HIDE),
        has_points,
        deepest=64,
    ),
    Step(
        "path_nee",
        "path_nee",
        "Every vertex asks one light.",
        "caustics of point, spot and directional lamps",
        (DEPTH, HIDE, CHOICE),
        has_caustics_of_points,
    ),
    Step(
        "path",
        "path",
        "Lights and material are both sampled, and weighted against each other.",
        "caustics of point, spot and directional lamps",
        (DEPTH, ROULETTE, HIDE, CHOICE),
        has_caustics_of_points,
    ),
    Step(
        "guided",
        "guided",
        "Some paths learn where light comes from, and the others are sent there.",
        "caustics of point, spot and directional lamps",
        (DEPTH, ROULETTE, HIDE, CHOICE),
        has_caustics_of_points,
    ),
    Step(
        "ptracer",
        "ptracer",
        "Paths begin at the lights, and each vertex is shown to the camera.",
        "what is seen in a mirror or through smooth glass",
        (DEPTH, ROULETTE, HIDE),
        has_mirrors,
    ),
    Step(
        "bdpt",
        "bdpt",
        "Paths from the lights and from the camera, joined in all ways.",
        "caustics of point, spot and directional lamps in mirrors and panes",
        (DEPTH, ROULETTE, HIDE),
        has_caustics_of_points,
    ),
    Step(
        "sppm",
        "sppm",
        "Light paths leave photons, which camera paths count within a radius that shrinks.",
        "",
        (DEPTH, ROULETTE, HIDE),
    ),
    Step(
        "vcm",
        "vcm",
        "Paths from both ends, joined in all ways, and photons.",
        "",
        (DEPTH, ROULETTE, HIDE),
    ),
    Step(
        "mmlt",
        "mmlt",
        "Chains of paths by the strategies of bdpt: where there is light, more are tried.",
        "caustics of point, spot and directional lamps in mirrors and panes",
        (DEPTH, HIDE, CHOICE),
        has_caustics_of_points,
        deepest=8,
    ),
)
"""The steps, from the simplest algorithm to the most capable one."""

ELSEWHERE: dict[str, str] = {
    "prb": "`path` with other defaults",
    "direct_projective": "`direct`, with gradients with respect to moving shapes",
    "prb_projective": "`path`, with gradients with respect to moving shapes",
    "upbp": "`vcm`, with media in which rays gather photons and beams of light",
    "volpath": "`path`, with media that scatter light",
    "volpathmis": "`volpath`, with weights for media of several colours",
    "volpathcache": "`volpathmis`, with paths that end in a cache of the light in media",
    "prbvolpath": "`volpath` with other defaults",
    "volprim_rf_basic": "the radiance fields of ellipsoids, without scattering",
    "depth": "distances, not light",
    "aov": "properties of surfaces, not light",
    "moment": "another integrator and its squares",
}
"""The integrators that aren't steps, with the reason."""

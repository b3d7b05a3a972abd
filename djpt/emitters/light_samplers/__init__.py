"""Light samplers, which choose the emitter to sample: one per file."""

from collections.abc import Sequence

from djpt.emitters.base import Emitter
from djpt.emitters.light_samplers.sampling import LightSampler

__all__ = ["LIGHT_SAMPLERS", "LightSampler", "make_light_sampler"]

LIGHT_SAMPLERS = ("uniform", "power", "tree")


def make_light_sampler(name: str, emitters: Sequence[Emitter]) -> LightSampler:
    """The light sampler with one of the names in `LIGHT_SAMPLERS`.

    `sampling_weight`s count as in Mitsuba: as soon as one of them isn't 1.
    """
    # A scene imports the one that it has.
    if name == "tree":
        from djpt.emitters.light_samplers.tree import TreeLightSampler

        return TreeLightSampler(emitters)
    if name == "power" or any(e.sampling_weight() != 1 for e in emitters):
        from djpt.emitters.light_samplers.weighted import WeightedLightSampler

        return WeightedLightSampler(emitters, by_power=name == "power")
    from djpt.emitters.light_samplers.weighted import UniformLightSampler

    return UniformLightSampler(emitters)

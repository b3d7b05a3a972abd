"""Light samplers, which choose the emitter to sample: one per file."""

from collections.abc import Sequence

from djpt.emitters.base import Emitter
from djpt.emitters.light_samplers.base import EmitterChoice

__all__ = ["CHOICES", "EmitterChoice", "make_choice"]

CHOICES = ("uniform", "power", "tree")


def make_choice(name: str, emitters: Sequence[Emitter]) -> EmitterChoice:
    """The light sampler with one of the names in `CHOICES`.

    `sampling_weight`s count as in Mitsuba: as soon as one of them isn't 1.
    """
    # A scene imports the one that it has.
    if name == "tree":
        from djpt.emitters.light_samplers.tree import TreeChoice

        return TreeChoice(emitters)
    if name == "power" or any(e.sampling_weight() != 1 for e in emitters):
        from djpt.emitters.light_samplers.weighted import WeightedChoice

        return WeightedChoice(emitters, by_power=name == "power")
    from djpt.emitters.light_samplers.uniform import UniformChoice

    return UniformChoice(emitters)

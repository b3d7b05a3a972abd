"""The choice of the emitter to sample: one way of choosing per file."""

from collections.abc import Sequence

from djpt.emitters.base import Emitter
from djpt.emitters.choice.base import EmitterChoice
from djpt.emitters.choice.tree import TreeChoice
from djpt.emitters.choice.uniform import UniformChoice
from djpt.emitters.choice.weighted import WeightedChoice

__all__ = ["CHOICES", "EmitterChoice", "TreeChoice", "UniformChoice", "WeightedChoice", "make_choice"]

CHOICES = ("uniform", "power", "tree")


def make_choice(name: str, emitters: Sequence[Emitter]) -> EmitterChoice:
    """The way of choosing with one of the names in `CHOICES`.

    `sampling_weight`s count as in Mitsuba: as soon as one of them isn't 1.
    """
    if name == "power":
        return WeightedChoice(emitters, by_power=True)
    if name == "tree":
        return TreeChoice(emitters)
    if any(e.sampling_weight != 1 for e in emitters):
        return WeightedChoice(emitters, by_power=False)
    return UniformChoice(emitters)

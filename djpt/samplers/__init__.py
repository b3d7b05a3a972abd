"""Samplers: one file each, one registration line each."""

from djpt.description.registry import register_sampler
from djpt.samplers.base import SampleIndex, Sampler, SampleStream
from djpt.samplers.independent import Independent

__all__ = ["Independent", "SampleIndex", "SampleStream", "Sampler"]

register_sampler("independent", Independent)

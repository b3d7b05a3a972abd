"""Samplers: one file each, one registration line each."""

from djpt.description.registry import register_sampler
from djpt.samplers.base import SampleIndex, Sampler, SampleStream
from djpt.samplers.independent import Independent
from djpt.samplers.ldsampler import LDSampler
from djpt.samplers.multijitter import Multijitter
from djpt.samplers.orthogonal import Orthogonal
from djpt.samplers.sobol import Sobol
from djpt.samplers.stratified import Stratified

__all__ = [
    "Independent",
    "LDSampler",
    "Multijitter",
    "Orthogonal",
    "SampleIndex",
    "SampleStream",
    "Sampler",
    "Sobol",
    "Stratified",
]

register_sampler("independent", Independent)
register_sampler("ldsampler", LDSampler)
register_sampler("multijitter", Multijitter)
register_sampler("orthogonal", Orthogonal)
register_sampler("sobol", Sobol)
register_sampler("stratified", Stratified)

"""Optimisers under the name that Mitsuba scripts use: those of `drjit.opt`.

opt = djpt.ad.Adam(lr=0.05, params={key: params[key]})
"""

from __future__ import annotations

from drjit.opt import SGD, Adam, AdamW, GradScaler, Optimizer, RMSProp

__all__ = ["SGD", "Adam", "AdamW", "GradScaler", "Optimizer", "RMSProp"]

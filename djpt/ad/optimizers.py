"""Mitsuba's place of the optimisers, which are those of `drjit.opt`."""

from __future__ import annotations

from drjit.opt import SGD, Adam, AdamW, GradScaler, Optimizer, RMSProp

__all__ = ["SGD", "Adam", "AdamW", "GradScaler", "Optimizer", "RMSProp"]

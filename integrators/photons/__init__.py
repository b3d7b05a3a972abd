"""Photons: records that light paths leave on surfaces, for camera paths to gather."""

from __future__ import annotations

from djpt.integrators.photons.map import PhotonMap, inverse_coverage
from djpt.integrators.photons.photon import Photon, PhotonStore

__all__ = ["Photon", "PhotonMap", "PhotonStore", "inverse_coverage"]

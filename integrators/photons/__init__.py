"""Photons: what light paths leave on surfaces, kept for camera paths that come by."""

from __future__ import annotations

from djpt.integrators.photons.coverage import inverse_coverage
from djpt.integrators.photons.map import PhotonMap
from djpt.integrators.photons.photon import Photon, PhotonStore

__all__ = ["Photon", "PhotonMap", "PhotonStore", "inverse_coverage"]

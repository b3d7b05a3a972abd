"""Photons: records that light paths leave on surfaces and in media, for camera paths to gather."""

from __future__ import annotations

from djpt.integrators.photons.coverage import inverse_coverage, inverse_coverage_in_medium
from djpt.integrators.photons.map import PhotonMap
from djpt.integrators.photons.photon import NOWHERE, Photon, PhotonStore

__all__ = ["NOWHERE", "Photon", "PhotonMap", "PhotonStore", "inverse_coverage", "inverse_coverage_in_medium"]

"""The names of Mitsuba that djpt leaves out on purpose, each family with its reason."""

from __future__ import annotations

from fnmatch import fnmatchcase

__all__ = ["REASONS", "reason"]

POLARISATION = "Polarisation: djpt computes with unpolarised light."
SPECTRAL = "Spectral rendering: djpt computes with red, green and blue."
STREAMS = "C++ streams: Python's files and bytes do the same, and every function takes paths."
LOGGING = "The C++ log's outputs and line formats: Python's `logging` does the same; `djpt.logger()` sets the level."
LOADER = "The stages of the C++ scene loader: `djpt.xml.read_file` gives a description as a dict that can be edited."
PATHS = "C++ paths: functions take Python's strings and `pathlib.Path`."
MACHINERY = "Machinery between C++ and Python that has nothing to connect here."
THREADS = "C++ threads and their debugging: Dr.Jit's own threads run kernels, Python's threads the rest."
OPTIX = "NVIDIA's closed OptiX library, for Mitsuba's CUDA variants only."

REASONS: dict[str, str] = {
    "mueller": POLARISATION,
    "mueller.*": POLARISATION,
    "*polarized": POLARISATION,
    "depolarizer": POLARISATION,
    "srgb_model_*": SPECTRAL,
    "sample_rgb_spectrum": SPECTRAL,
    "pdf_rgb_spectrum": SPECTRAL,
    "Stream": STREAMS,
    "Stream.*": STREAMS,
    "DummyStream*": STREAMS,
    "FileStream*": STREAMS,
    "MemoryStream*": STREAMS,
    "ZStream*": STREAMS,
    "MemoryMappedFile*": STREAMS,
    "StreamAppender*": LOGGING,
    "Appender*": LOGGING,
    "Formatter*": LOGGING,
    "DefaultFormatter*": LOGGING,
    "Logger.*appender*": LOGGING,
    "Logger.*formatter": LOGGING,
    "Logger.read_log": LOGGING,
    "Logger.log_progress": LOGGING,
    "parser": LOADER,
    "parser.*": LOADER,
    "filesystem": PATHS,
    "filesystem.*": PATHS,
    "detail": MACHINERY,
    "detail.*": MACHINERY,
    "StructConverter*": MACHINERY,
    "Object.ptr": MACHINERY,
    "Object.expand": MACHINERY,
    "Thread.thread": THREADS,
    "Thread.wait_for_tasks": THREADS,
    "misc.trap_debugger": THREADS,
    "OptixDenoiser*": OPTIX,
}
"""Reasons by pattern. ``*`` stands for any characters, as in file names."""


def reason(path: str) -> str:
    """Why a name is left out; empty if there is no reason."""
    return next((why for pattern, why in REASONS.items() if fnmatchcase(path, pattern)), "")

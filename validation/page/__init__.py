"""The page of a comparison, for browsers: one HTML file that needs no network."""

from __future__ import annotations

from djpt.validation.page.writing import html, write_page

__all__ = ["html", "write_page"]

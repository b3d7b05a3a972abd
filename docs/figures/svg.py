"""Drawings of boxes, lines and arrows as SVG: text that is the same wherever it is made."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from typing import Any

__all__ = ["BLUE", "GREY", "RED", "Box", "Drawing"]

BLUE, GREY, RED = "#2a5db0", "#8a8f98", "#c2410c"

FONTS = {"plain": "Helvetica, Arial, sans-serif", "code": "Menlo, Consolas, monospace"}


@dataclass(frozen=True)
class Box:
    """A rectangle, in pixels from the top left corner."""

    x: float
    y: float
    width: float
    height: float

    def at(self, across: float, down: float) -> tuple[float, float]:
        """The point at two fractions of the sides."""
        return self.x + across * self.width, self.y + down * self.height


@dataclass
class Drawing:
    """Boxes, arrows and texts on white, drawn in the order in which they are added."""

    width: float
    height: float
    title: str
    """What readers hear who don't see it."""
    parts: list[str] = field(default_factory=list)

    def box(self, box: Box, fill: str = "#ffffff", stroke: str = GREY) -> None:
        """Draw a rectangle with round corners."""
        self.parts.append(
            f'<rect x="{box.x:g}" y="{box.y:g}" width="{box.width:g}" height="{box.height:g}" rx="5" '
            f'fill="{fill}" stroke="{stroke}"/>'
        )

    def polygon(
        self, points: Any, fill: str = "none", stroke: str = GREY, width: float = 1, opacity: float = 1
    ) -> None:
        """Draw a polygon through points (n, 2)."""
        corners = " ".join(f"{x:.5g},{y:.5g}" for x, y in points)
        clear = "" if opacity == 1 else f' fill-opacity="{opacity:g}"'
        self.parts.append(
            f'<polygon points="{corners}" fill="{fill}" stroke="{stroke}" stroke-width="{width:g}"{clear}/>'
        )

    def line(self, points: Any, color: str = GREY, width: float = 1.4, *, dashed: bool = False) -> None:
        """Draw a line through points (n, 2)."""
        corners = " ".join(f"{x:.5g},{y:.5g}" for x, y in points)
        dashes = ' stroke-dasharray="5 4"' if dashed else ""
        self.parts.append(
            f'<polyline points="{corners}" fill="none" stroke="{color}" stroke-width="{width:g}"{dashes}/>'
        )

    def text(
        self,
        at: tuple[float, float],
        text: str,
        size: float = 12,
        *,
        code: bool = False,
        bold: bool = False,
        color: str = "#1b1f24",
        middle: bool = False,
    ) -> None:
        """Write a line; `at` is the left end or the `middle` of its base."""
        weight = ' font-weight="bold"' if bold else ""
        anchor = ' text-anchor="middle"' if middle else ""
        self.parts.append(
            f'<text x="{at[0]:.5g}" y="{at[1]:.5g}" font-family="{FONTS["code" if code else "plain"]}" '
            f'font-size="{size:g}" fill="{color}"{weight}{anchor}>{escape(text)}</text>'
        )

    def arrow(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        color: str = GREY,
        *,
        dashed: bool = False,
        bend: tuple[float, float] | None = None,
    ) -> None:
        """Draw an arrow, by way of a point if it is to `bend`."""
        way = f"L {end[0]:.5g} {end[1]:.5g}"
        if bend is not None:
            way = f"Q {bend[0]:.5g} {bend[1]:.5g} {end[0]:.5g} {end[1]:.5g}"
        dashes = ' stroke-dasharray="5 4"' if dashed else ""
        self.parts.append(
            f'<path d="M {start[0]:.5g} {start[1]:.5g} {way}" fill="none" stroke="{color}" stroke-width="1.4"'
            f'{dashes} marker-end="url(#head-{color[1:]})"/>'
        )

    def finished(self) -> str:
        """The text of the file."""
        heads = "".join(
            f'<marker id="head-{color[1:]}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
            f'orient="auto"><path d="M 0 0 L 8 4 L 0 8 z" fill="{color}"/></marker>'
            for color in (BLUE, GREY, RED)
        )
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:g} {self.height:g}" '
            f'width="{self.width:g}" height="{self.height:g}" role="img">',
            f"<title>{escape(self.title)}</title>",
            f"<defs>{heads}</defs>",
            f'<rect width="{self.width:g}" height="{self.height:g}" fill="#ffffff"/>',
            *self.parts,
            "</svg>",
        ]
        return "\n".join(lines) + "\n"

"""The small pictures of the front page, cut from the others."""

from __future__ import annotations

from PIL import Image, ImageOps

from places import IMAGES

__all__ = ["cards"]

SIZE = 480, 240

CUTS: dict[str, tuple[int, int, int, int]] = {
    "spp": (8, 8, 336, 168),
    "shapes": (0, 0, 720, 360),
    "materials": (430, 512, 840, 712),
    "textures": (430, 10, 840, 210),
    "lights": (704, 286, 1155, 506),
    "media": (11, 10, 419, 210),
    "cameras": (0, 0, 480, 240),
    "ladder_paths": (264, 12, 756, 252),
    "samplers": (0, 0, 960, 480),
    "tonemapping": (0, 0, 488, 240),
    "derivatives": (10, 10, 452, 226),
    "proof": (298, 13, 855, 285),
    "bounces": (154, 154, 462, 308),
}
"""Left, upper, right and lower edge of what is shown of a picture: two of its panels, without their captions."""


def cards() -> None:
    """Cut a part out of each picture of `CUTS`."""
    (IMAGES / "cards").mkdir(exist_ok=True)
    for name, box in CUTS.items():
        with Image.open(IMAGES / f"{name}.png") as picture:
            part = ImageOps.fit(picture.convert("RGB").crop(box), SIZE, Image.Resampling.LANCZOS)
        part.save(IMAGES / "cards" / f"{name}.jpg", quality=85, optimize=True)

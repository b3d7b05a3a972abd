"""The house: the rooms of djpt on their floors, and which import which, read from the sources."""

from __future__ import annotations

from imports import Graph, imports, modules, rooms
from places import IMAGES, ROOT
from svg import GREY, RED, Box, Drawing

__all__ = ["house"]

FLOORS = {
    "for people": ("benchmarks", "__main__", "djpt"),
    "wings": ("scenes", "mitsuba", "validation", "apps"),
    "images": ("integrators", "rendering"),
    "composition": ("scene", "models", "photographs"),
    "space": ("shapes", "geometry", "sensors", "emitters"),
    "scattering": ("materials", "phase", "media"),
    "lookups": ("textures", "volumes", "films", "samplers"),
    "tables": ("dispatch", "distributions", "rfilters", "images"),
    "plugins": ("description",),
    "ground": ("errors", "version", "jit", "core"),
}
"""The rooms, the top floor first. A room uses what is below it, or to its left on its floor."""

WORDS = {
    "__main__": "python -m djpt",
    "benchmarks": "djpt.benchmarks",
    "djpt": "public names",
    "scenes": "built-in scenes",
    "mitsuba": "names for scripts",
    "validation": "comparing, checking",
    "apps": "commands, viewer, ..",
    "integrators": "one estimator per file",
    "rendering": "schedules, derivatives",
    "scene": "plugins put together",
    "models": "files to scenes",
    "photographs": "cameras that took them",
    "shapes": "surfaces",
    "geometry": "ray queries",
    "sensors": "cameras, meters",
    "emitters": "lights, and choosing one",
    "materials": "BSDFs",
    "phase": "phase functions",
    "media": "what fills space",
    "textures": "colours on surfaces",
    "volumes": "colours in space",
    "rfilters": "reconstruction",
    "images": "finished pictures",
    "films": "sums of samples",
    "samplers": "random numbers",
    "description": "dicts to plugins",
    "distributions": "tabulated densities",
    "dispatch": "calls per lane",
    "errors": "one family",
    "version": "one number",
    "jit": "Dr.Jit and LLVM",
    "core": "rays, frames, files",
}
"""What is written into the rooms."""

FLOOR, LEFT, WIDE, HIGH, GAP = 92, 130, 178, 50, 32
"""The height of a floor, where its rooms begin, the size of a room, and the distance of two, in pixels."""

ORDER = [room for floor in reversed(FLOORS.values()) for room in floor]


def upward(graph: Graph) -> list[tuple[str, str]]:
    """The arrows that go up, or to the right on a floor."""
    return sorted((a, b) for a in graph for b in graph[a] if ORDER.index(b) > ORDER.index(a))


def direct(graph: Graph) -> list[tuple[str, str]]:
    """The arrows that go down and don't follow from others: a room uses whatever they lead to."""
    down = {a: {b for b in graph[a] if ORDER.index(b) < ORDER.index(a)} for a in graph}
    below: Graph = {}
    for a in ORDER:
        below[a] = set().union(*(below[b] | {b} for b in down[a]))
    return sorted((a, b) for a in down for b in down[a] if not any(b in below[c] for c in down[a]))


def graph() -> Graph:
    """Which rooms import which."""
    return rooms(imports({name: path.read_text() for name, path in modules(ROOT).items()}))


def drawn(arrows: Graph) -> str:
    """The picture of a house with these arrows."""
    drawing = Drawing(980, FLOOR * len(FLOORS) + 46, "The rooms of djpt, and which import which")
    places: dict[str, Box] = {}
    for number, (title, names) in enumerate(FLOORS.items()):
        top = 8 + number * FLOOR
        drawing.box(Box(6, top, drawing.width - 12, FLOOR - 14), "#f3f5f8", "#f3f5f8")
        drawing.text((16, top + FLOOR / 2 - 3), title, 13, bold=True, color="#4b5563")
        left = LEFT + (4 - len(names)) * (WIDE + GAP) / 2
        for place, name in enumerate(names):
            places[name] = Box(left + place * (WIDE + GAP), top + (FLOOR - 14 - HIGH) / 2, WIDE, HIGH)
    for a, b in direct(arrows):
        connect(drawing, places[a], places[b], GREY, dashed=False)
    for box in places.values():
        drawing.box(box)
    for a, b in upward(arrows):
        connect(drawing, places[a], places[b], RED, dashed=True)
    for name, box in places.items():
        drawing.text(box.at(0.5, 0.45), name, 14, code=True, bold=True, middle=True)
        drawing.text(box.at(0.5, 0.8), WORDS[name], 11, middle=True, color="#4b5563")
    key = drawing.height - 18
    drawing.arrow((LEFT, key), (LEFT + 40, key))
    drawing.text((LEFT + 48, key + 4), "uses, and whatever that uses in turn")
    drawing.arrow((LEFT + 330, key), (LEFT + 370, key), RED, dashed=True)
    drawing.text((LEFT + 378, key + 4), "uses a room above: a few imports, listed in the text")
    return drawing.finished()


def connect(drawing: Drawing, a: Box, b: Box, color: str, *, dashed: bool) -> None:
    """Draw an arrow from one room to another, between the sides that face each other."""
    if a.y == b.y:
        to_the_left = b.x < a.x
        start, end = (a.at(0, 0.5), b.at(1, 0.5)) if to_the_left else (a.at(1, 0.3), b.at(0, 0.3))
        beyond = abs(a.x - b.x) > WIDE + GAP  # another room is between them
        if beyond:
            start, end = a.at(0.5, 1), b.at(0.5, 1)
        middle = ((start[0] + end[0]) / 2, start[1] + 26)
        drawing.arrow(start, end, color, dashed=dashed, bend=middle if beyond else None)
        return
    down = b.y > a.y
    lean = max(-0.35, min(0.35, (b.x - a.x) / 900))
    shift = -0.06 if down else 0.06  # both ways stay apart
    start = a.at(0.5 + lean + shift, 1 if down else 0)
    end = b.at(0.5 - lean + shift, 0 if down else 1)
    drawing.arrow(start, end, color, dashed=dashed)


def house() -> None:
    """The rooms on their floors, with an arrow from each room to those that it uses."""
    (IMAGES / "house.svg").write_text(drawn(graph()), encoding="utf-8")

"""A hamlet as an OpenStreetMap extract, drawn by hand, and what draws others."""

import math

LATITUDE, LONGITUDE, METERS_A_DEGREE = 47.6, -122.3, 111_195.0


class Drawing:
    """An extract in the making. Points are meters to the east and to the south."""

    def __init__(self) -> None:
        self.elements: list[str] = []
        self._count = 0

    def node(self, x: float, y: float, tags: str = "") -> int:
        self._count += 1
        latitude = LATITUDE - y / METERS_A_DEGREE
        longitude = LONGITUDE + x / (METERS_A_DEGREE * math.cos(math.radians(LATITUDE)))
        self.elements.append(
            f'<node id="{self._count}" version="1" lat="{latitude:.7f}" lon="{longitude:.7f}">{with_tags(tags)}</node>'
        )
        return self._count

    def way(self, number: int, points: list, tags: str) -> None:
        """A way through points, or nodes that exist already."""
        nodes = [point if isinstance(point, int) else self.node(*point) for point in points]
        references = "".join(f'<nd ref="{node}"/>' for node in nodes)
        self.elements.append(f'<way id="{number}" version="1">{references}{with_tags(tags)}</way>')

    def box(self, number: int, left: float, top: float, right: float, bottom: float, tags: str, *more: int) -> None:
        """A rectangle; further nodes lie on its lower side, from the right to the left."""
        first = self.node(left, top)
        self.way(number, [first, (right, top), (right, bottom), *more, (left, bottom), first], tags)

    def text(self) -> str:
        # Formats want nodes first, then ways.
        ordered = sorted(self.elements, key=lambda element: not element.startswith("<node"))
        return f'<osm version="0.6">{"".join(ordered)}</osm>'


def with_tags(tags: str) -> str:
    """The XML of tags, given as `key=value` separated by spaces."""
    pairs = (tag.split("=") for tag in tags.split())
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in pairs)


def hamlet() -> Drawing:
    """A street from west to east; north of it a house with a mapped door and walk, and one with neither; a shed."""
    drawing = Drawing()
    drawing.way(1, [(-80, 0), (0, 0), (80, 0)], "highway=residential width=8 sidewalk=right name=Main")
    door = drawing.node(-20, -14, "entrance=main")
    drawing.box(2, -26, -24, -14, -14, "building=house addr:housenumber=1", door)
    drawing.way(3, [door, (-20, 0)], "highway=footway")
    drawing.box(4, 10, -30, 24, -20, "building=house addr:housenumber=3 addr:street=Main")
    drawing.box(5, 0, -44, 4, -40, "building=shed")
    drawing.way(6, [(-40, -34), (0, -34)], "barrier=fence")
    drawing.node(-8, -20, "natural=tree")
    return drawing

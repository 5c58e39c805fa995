"""Solids and sheets that the built-in scene is put together from.

Every function returns a `Shape`: indexed triangles, counter-clockwise seen from
outside, with unit normals and uv in metres (v runs down, as in glTF), so that one
texture repeat is one metre until `Shape.tiled` says otherwise.
"""

from typing import NamedTuple

import numpy as np

Point = tuple[float | int, float | int, float | int]


class Shape(NamedTuple):
    """Indexed triangles in double precision."""

    position: np.ndarray  # (v, 3)
    triangles: np.ndarray  # int (t, 3)
    normal: np.ndarray  # (v, 3), unit
    uv: np.ndarray  # (v, 2)

    def tiled(self, u: float, v: float | None = None) -> "Shape":
        """Returns the shape with texture repeats every u and v metres."""
        return self._replace(uv=self.uv / (u, u if v is None else v))

    def moved(self, offset: Point) -> "Shape":
        """Returns the shape shifted."""
        return self._replace(position=self.position + offset)

    def turned(self, degrees: float) -> "Shape":
        """Returns the shape turned about the y axis, counter-clockwise from above."""
        matrix = rotation_y(np.radians(degrees))
        return self._replace(
            position=self.position @ matrix.T, normal=self.normal @ matrix.T
        )


class Part(NamedTuple):
    """A shape that becomes a mesh of its own."""

    name: str
    shape: Shape
    material: str
    group: str = "static"


def rotation_y(angle: float) -> np.ndarray:
    """Returns the 3×3 rotation about the y axis by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Returns the 3×3 rotation about a unit axis by an angle in radians."""
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Scales vectors to length one; zero vectors become +y."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), (0.0, 1.0, 0))


def merge(shapes: list[Shape]) -> Shape:
    """Joins shapes into one."""
    first = np.cumsum([0] + [len(s.position) for s in shapes[:-1]])
    return Shape(
        np.concatenate([s.position for s in shapes]),
        np.concatenate(
            [s.triangles + start for s, start in zip(shapes, first, strict=True)]
        ),
        np.concatenate([s.normal for s in shapes]),
        np.concatenate([s.uv for s in shapes]),
    )


def quad(corner: Point, across: Point, up: Point) -> Shape:
    """Makes a flat rectangle; its normal is across × up, and v falls along up."""
    a, u = np.array(across, float), np.array(up, float)
    c = np.array(corner, float)
    normal = unit(np.cross(a, u))
    width, height = np.linalg.norm(a), np.linalg.norm(u)
    return Shape(
        np.stack([c, c + a, c + a + u, c + u]),
        np.array([[0, 1, 2], [0, 2, 3]]),
        np.tile(normal, (4, 1)),
        np.array([[0.0, height], [width, height], [width, 0.0], [0.0, 0.0]]),
    )


def box(low: Point, high: Point) -> Shape:
    """Makes an axis-aligned box with sharp edges.

    The uv of walls are (x or z, −y) and those of floors (x, z), so that neighbouring
    boxes continue one texture.
    """
    lo, hi = np.array(low, float), np.array(high, float)
    position, normal, uv = [], [], []
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            corners = np.empty((4, 3))
            corners[:, axis] = (lo, hi)[side][axis]
            order = ((0, 0), (1, 0), (1, 1), (0, 1))
            for i, (s, t) in enumerate(order if side else order[::-1]):
                corners[i, b] = (lo, hi)[s][b]
                corners[i, c] = (lo, hi)[t][c]
            n = np.zeros(3)
            n[axis] = 1.0 if side else -1.0
            position.append(corners)
            normal.append(np.tile(n, (4, 1)))
            plane = {0: (2, 1), 1: (0, 2), 2: (0, 1)}[axis]
            flip = (1.0, 1.0) if axis == 1 else (1.0, -1.0)
            uv.append(corners[:, plane] * flip)
    first = 4 * np.arange(6)[:, None, None]
    triangles = (np.array([[0, 1, 2], [0, 2, 3]]) + first).reshape(-1, 3)
    return Shape(
        np.concatenate(position), triangles, np.concatenate(normal), np.concatenate(uv)
    )


def pierced_wall(
    low: Point, high: Point, openings: list[tuple[float, float, float, float]]
) -> Shape:
    """Makes a wall along x with rectangular openings through its thickness.

    Args:
        low: corner of the wall.
        high: opposite corner.
        openings: (x0, x1, y0, y1), from left to right, not overlapping.
    """
    (x0, y0, z0), (x1, y1, z1) = low, high
    spans, x = [], x0
    for a, b, bottom, top in openings:
        spans += [(x, a, y0, y1), (a, b, y0, bottom), (a, b, top, y1)]
        x = b
    spans.append((x, x1, y0, y1))
    return merge(
        [
            box((a, bottom, z0), (b, top, z1))
            for a, b, bottom, top in spans
            if b > a and top > bottom
        ]
    )


def beam(start: Point, end: Point, width: float, height: float) -> Shape:
    """Makes a straight bar of rectangular section; u runs along it."""
    a, b = np.array(start, float), np.array(end, float)
    along = b - a
    length = float(np.linalg.norm(along))
    along = along / length
    side = np.cross((0.0, 1.0, 0.0), along)
    side = unit(side) if np.linalg.norm(side) > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.cross(along, side)
    bar = box((-width / 2, -height / 2, 0.0), (width / 2, height / 2, length))
    frame = np.stack([side, up, along])
    along_first = bar.uv.copy()
    flat = np.abs(bar.normal[:, 1]) > 0.5
    along_first[flat] = bar.uv[flat][:, ::-1]
    return Shape(
        bar.position @ frame + a, bar.triangles, bar.normal @ frame, along_first
    )


def sheet(
    points: np.ndarray, uv: np.ndarray | None = None, *, closed: bool = False
) -> Shape:
    """Makes a smooth surface through a grid of points (rows, columns, 3).

    The outside is where rows × columns point (d/drow × d/dcolumn). The uv default to
    arc lengths, u along the columns and v along the rows.

    Args:
        points: the grid.
        uv: (rows, columns, 2).
        closed: the last column meets the first; normals agree over the seam.
    """
    rows, columns = points.shape[:2]
    if uv is None:
        du = np.linalg.norm(np.diff(points, axis=1), axis=-1).mean(axis=0)
        dv = np.linalg.norm(np.diff(points, axis=0), axis=-1).mean(axis=1)
        u, v = np.concatenate([[0.0], du]).cumsum(), np.concatenate([[0], dv]).cumsum()
        uv = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=-1)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    triangles = np.concatenate(
        [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    )
    position = points.reshape(-1, 3)
    e1 = position[triangles[:, 1]] - position[triangles[:, 0]]
    e2 = position[triangles[:, 2]] - position[triangles[:, 0]]
    plane = np.cross(e1, e2)
    kept = np.linalg.norm(plane, axis=1) > 1e-12
    triangles, plane = triangles[kept], plane[kept]
    normal = np.zeros_like(position)
    for corner in range(3):
        for axis in range(3):
            normal[:, axis] += np.bincount(
                triangles[:, corner], plane[:, axis], len(position)
            )
    grid = normal.reshape(rows, columns, 3)
    if closed:
        grid[:, 0] += grid[:, -1]
        grid[:, -1] = grid[:, 0]
    for edge in (0, rows - 1):  # a row that shrinks to a point has one normal
        if np.ptp(points[edge], axis=0).max() < 1e-9:
            grid[edge] = grid[edge].sum(axis=0)
    return Shape(position, triangles, unit(grid.reshape(-1, 3)), uv.reshape(-1, 2))


def lathe(profile: list[tuple[float, float]], sides: int = 24) -> Shape:
    """Turns a profile of (radius, y), from bottom to top, about the y axis.

    Close a solid by a radius of 0 at both ends. A corner stays sharp where a profile
    point is given twice.
    """
    runs: list[list[tuple[float, float]]] = [[]]
    for point in profile:
        if runs[-1] and runs[-1][-1] == point:
            runs.append([])
        runs[-1].append(point)
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    ring = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
    ring[-1] = ring[0]
    parts = []
    for run in runs:
        r, y = np.array(run).T
        points = ring[None] * r[:, None, None]
        points[..., 1] = y[:, None]
        turn = angle * max(float(r.max()), 1e-3)
        length = np.concatenate([[0], np.hypot(np.diff(r), np.diff(y))]).cumsum()
        uv = np.stack(np.broadcast_arrays(turn[None], -length[:, None]), axis=-1)
        parts.append(flipped(sheet(points, uv, closed=True)))
    return merge(parts)


def flipped(shape: Shape) -> Shape:
    """Turns a shape inside out."""
    return shape._replace(triangles=shape.triangles[:, ::-1], normal=-shape.normal)


def facing(shape: Shape, direction: Point) -> Shape:
    """Returns an open surface with its outside toward a direction, on the whole."""
    return (
        shape if np.sum(shape.normal @ np.array(direction)) >= 0.0 else flipped(shape)
    )


def tube(path: np.ndarray, radius: float | np.ndarray, sides: int = 8) -> Shape:
    """Sweeps a circle along a path (n, 3), with flat caps; u runs around it.

    Args:
        path: the centre line.
        radius: one, or one per path point.
        sides: of the circle.
    """
    path = np.asarray(path, float)
    radius = np.broadcast_to(np.asarray(radius, float), len(path))
    tangent = unit(np.gradient(path, axis=0))
    side = np.empty_like(path)
    start = np.array([0.0, 0, 1]) if abs(tangent[0, 2]) < 0.9 else np.array([1.0, 0, 0])
    for i, t in enumerate(tangent):
        start = unit(start - t * np.dot(start, t))
        side[i] = start
    other = np.cross(tangent, side)
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    ring = (
        side[:, None] * np.cos(angle)[:, None] + other[:, None] * np.sin(angle)[:, None]
    )
    ring[:, -1] = ring[:, 0]
    points = path[:, None] + ring * radius[:, None, None]
    body = flipped(sheet(points, closed=True))
    caps = []
    for end, outward in ((0, -tangent[0]), (-1, tangent[-1])):
        corners = np.concatenate([path[end][None], points[end, :-1]])
        k = np.arange(sides)
        fan = np.stack([np.zeros_like(k), 1 + k, 1 + (k + 1) % sides], axis=1)
        fan = fan[:, ::-1] if end == 0 else fan
        normal = np.tile(outward, (len(corners), 1))
        caps.append(Shape(corners, fan, normal, np.zeros((len(corners), 2))))
    return merge([body, *caps])


def line(start: Point, end: Point, radius: float, sides: int = 6) -> Shape:
    """Makes a straight round bar."""
    return tube(np.array([start, end], float), radius, sides)


def sagging(start: Point, end: Point, sag: float, count: int = 24) -> np.ndarray:
    """Returns points of a cable that hangs `sag` below the middle of its chord."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    points = np.array(start) * (1.0 - s) + np.array(end) * s
    points[:, 1] -= (4.0 * sag * s * (1.0 - s))[:, 0]
    return points


def cards(
    centre: np.ndarray,
    across: np.ndarray,
    up: np.ndarray,
    soft: np.ndarray | None = None,
    tile: np.ndarray | None = None,
) -> Shape:
    """Makes many rectangles, each showing one whole texture (or a part of it).

    Args:
        centre: (n, 3), their centres.
        across: (n, 3), half of their width.
        up: (n, 3), half of their height, toward v = 0.
        soft: (n, 3), directions that normals lean to; None: flat normals.
        tile: (n, 4), the part of the texture: u0, v0, u1, v1.
    """
    n = len(centre)
    normal = unit(np.cross(across, up))
    if soft is not None:
        # Shading turns normals to the viewer's side of the triangle, so a card's front
        # has to look the way its soft normal does.
        front = np.sum(normal * soft, axis=-1, keepdims=True) >= 0.0
        across, normal = (
            np.where(front, across, -across),
            np.where(front, normal, -normal),
        )
        normal = unit(0.35 * normal + soft)
    sign = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    position = (
        centre[:, None]
        + across[:, None] * sign[None, :, :1]
        + up[:, None] * sign[None, :, 1:]
    )
    if tile is None:
        tile = np.tile(np.array([0.0, 0.0, 1.0, 1.0]), (n, 1))
    u, v = tile[:, [0, 2, 2, 0]], tile[:, [3, 3, 1, 1]]
    first = 4 * np.arange(n)[:, None, None]
    triangles = (np.array([[0, 1, 2], [0, 2, 3]]) + first).reshape(-1, 3)
    return Shape(
        position.reshape(-1, 3),
        triangles,
        np.repeat(normal, 4, axis=0),
        np.stack([u, v], axis=-1).reshape(-1, 2),
    )


def signed_volume(shape: Shape) -> float:
    """Returns the enclosed volume; positive where faces wind outward."""
    a, b, c = (shape.position[shape.triangles[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def outward(shape: Shape) -> Shape:
    """Returns a closed surface right side out."""
    return shape if signed_volume(shape) >= 0.0 else flipped(shape)

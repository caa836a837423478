"""The semantic map once more, pixel by pixel and voxel by voxel, in plain Python and double precision.

Built another way than the package: the camera is a 3 x 4 projection matrix and its inverse, the map a dictionary of the
voxels that have been seen, the votes of a frame a counter for each voxel. No windows, no packed bytes, no scatter.

A decision that would fall otherwise if a number were off by `CLOSE` of itself counts as close: single precision may
decide it the other way. Tests draw frames without any.
"""

import math
from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np

CLOSE = 4e-6

NOTHING = 14


@dataclass
class Voxel:
    """What is known of a voxel that has been seen: evidence in twentieths, the class voted for, and how firmly."""

    evidence: int = 0
    class_index: int = 0
    confidence: int = 0


@dataclass
class OracleMap:
    """A map of voxels (level, row, column), those never seen left out.

    `close_calls` counts the decisions that rounding may turn.
    """

    rows: int
    columns: int
    cell_size: float
    levels: int
    level_height: float
    reach: float
    inset: float
    clearance: float
    voxels: dict[tuple[int, int, int], Voxel] = field(default_factory=dict)
    close_calls: int = 0

    def integrate(self, depth, classes, camera_matrix, position, rotation):
        """Take in one frame; `camera_matrix` is the 3 x 3 matrix of the intrinsics."""
        returns = self._returns(depth, camera_matrix)
        labels = self._labels_by_voxel(returns, classes, position, rotation)
        missed = self._missed(returns, depth.shape, camera_matrix, position, rotation)
        for place in missed - set(labels):
            voxel = self.voxels.setdefault(place, Voxel())
            voxel.evidence = max(voxel.evidence - 8, -40)
            self._forget_if_free(voxel)
        for place, seen in labels.items():
            voxel = self.voxels.setdefault(place, Voxel())
            voxel.evidence = min(voxel.evidence + 17, 70)
            self._vote(voxel, seen)
            self._forget_if_free(voxel)

    def terrain(self):
        """The map from above."""
        picture = np.zeros((self.rows, self.columns), np.uint8)
        for row in range(self.rows):
            for column in range(self.columns):
                picture[row, column] = self._terrain_of(row, column)
        return picture

    def dense(self):
        """Evidence (-128 where never seen), classes and confidence as arrays [levels rows columns]."""
        shape = (self.levels, self.rows, self.columns)
        evidence, classes, confidence = np.full(shape, -128), np.zeros(shape, int), np.zeros(shape, int)
        for place, voxel in self.voxels.items():
            evidence[place], classes[place], confidence[place] = voxel.evidence, voxel.class_index, voxel.confidence
        return evidence, classes, confidence

    def _terrain_of(self, row, column):
        votes, standing = Counter(), False
        for level in range(1, self.levels):
            voxel = self.voxels.get((level, row, column))
            bottom = level * self.level_height - self.level_height / 2
            if voxel is None or voxel.evidence <= 0 or bottom >= self.clearance:
                continue
            standing = True
            if voxel.class_index:
                votes[voxel.class_index] += voxel.confidence + 1
        if votes:
            return min(votes, key=lambda index: (-votes[index], index))
        ground = self.voxels.get((0, row, column))
        if standing:
            return NOTHING
        return ground.class_index if ground and ground.evidence > 0 else 0

    def _returns(self, depth, camera_matrix):
        """Pixel (row, column) -> depth and ray in the camera's frame, for pixels that are in reach."""
        found = {}
        for row, column in np.ndindex(depth.shape):
            meters = float(depth[row, column])
            if not math.isfinite(meters) or meters <= 0:
                continue
            ray = np.linalg.solve(camera_matrix, np.array([column, row, 1.0]))
            away = meters * math.hypot(*ray)
            self._decide(away, self.reach)
            if away <= self.reach:
                found[row, column] = meters, ray
        return found

    def _labels_by_voxel(self, returns, classes, position, rotation):
        labels = defaultdict(Counter)
        for pixel, (meters, ray) in returns.items():
            point = position + rotation @ (ray * meters + ray / math.hypot(*ray) * self.inset)
            place = (
                self._floor(point[2] / self.level_height + 0.5),
                self._floor(-point[1] / self.cell_size),
                self._floor(point[0] / self.cell_size),
            )
            if self._exists(place):
                label = int(classes[pixel])
                labels[place][label if label < 16 else 0] += 1
        return labels

    def _missed(self, returns, image_shape, camera_matrix, position, rotation):
        """Voxels above the ground that lie wholly in front of what is seen at their center and around it."""
        projection = camera_matrix @ np.hstack([rotation.T, -rotation.T @ position[:, None]])
        radius = 0.5 * math.sqrt(2 * self.cell_size**2 + self.level_height**2)
        missed = set()
        for level in range(1, self.levels):
            for row in range(self.rows):
                for column in range(self.columns):
                    center = np.array(
                        [(column + 0.5) * self.cell_size, -(row + 0.5) * self.cell_size, level * self.level_height]
                    )
                    away = float(np.linalg.norm(center - position))
                    u, v, meters = projection @ [*center, 1.0]
                    self._decide(away, self.reach)
                    self._decide(meters, 0.0)
                    if meters <= 0 or away > self.reach:
                        continue
                    pixel = self._floor(v / meters + 0.5), self._floor(u / meters + 0.5)
                    if pixel not in returns:
                        continue
                    around = [
                        returns[pixel[0] + below, pixel[1] + beside][0]
                        for below in (-1, 0, 1)
                        for beside in (-1, 0, 1)
                        if (pixel[0] + below, pixel[1] + beside) in returns
                    ]
                    self._decide(meters + radius, min(around))
                    if meters + radius < min(around):
                        missed.add((level, row, column))
        assert all(0 <= row < image_shape[0] and 0 <= column < image_shape[1] for row, column in returns)
        return missed

    @staticmethod
    def _vote(voxel, seen):
        """One vote of the frame, by the class most returns in the voxel have."""
        labeled = {index: count for index, count in seen.items() if index}
        if not labeled:
            return
        choice = min(labeled, key=lambda index: (-labeled[index], index))
        if voxel.confidence == 0:
            voxel.class_index, voxel.confidence = choice, 1
        elif voxel.class_index == choice:
            voxel.confidence = min(voxel.confidence + 1, 15)
        else:
            voxel.confidence -= 1

    @staticmethod
    def _forget_if_free(voxel):
        if voxel.evidence <= 0:
            voxel.class_index = voxel.confidence = 0

    def _exists(self, place):
        return all(0 <= index < size for index, size in zip(place, (self.levels, self.rows, self.columns), strict=True))

    def _decide(self, value, limit):
        self.close_calls += abs(value - limit) < CLOSE * max(1.0, abs(value), abs(limit))

    def _floor(self, value):
        self._decide(value, round(value))
        return math.floor(value)

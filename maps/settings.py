"""Settings of the offline side, and of everything live views must share with it to compare."""

from __future__ import annotations

from pydantic import Field, PositiveFloat

from descriptors.settings import ContourSettings
from semmap.settings import Settings


class FreeSpaceSettings(Settings):
    """How floor, walls and free space are told apart.

    cell : cell of the free-space raster [m].
    ground_cell : cell of the floor raster [m], a multiple of ``cell``.
    max_slope : steepest floor, rise over run; steeper surfaces are walls.
    wall_from, wall_to : height above the floor of the band whose points are walls [m].
    max_gap, max_gap_sparse : holes in a map's floor up to this width are closed, where it is well and where it is
        thinly sampled [m].
    max_clutter : obstacles in free space up to this area are not walls (vehicles, posts) [m²].
    view_range : of a keyframe, only what is nearer than this to its LiDAR is used [m].
    """

    cell: PositiveFloat = 0.2
    ground_cell: PositiveFloat = 0.4
    max_slope: PositiveFloat = 0.45
    wall_from: PositiveFloat = 0.4
    wall_to: PositiveFloat = 1.8
    max_gap: PositiveFloat = 0.6
    max_gap_sparse: PositiveFloat = 2.4
    max_clutter: PositiveFloat = 6.0
    view_range: PositiveFloat = 20.0


class TopologySettings(Settings):
    """What counts as a roadway and as an intersection.

    min_branch : shorter dead ends are niches of the wall, not branches [m].
    min_aspect : dead ends that reach less far beyond the mouth than this many widths are niches, too.
    open_branch : a dead end that goes on unseen is a branch if it is this many times as long as its mouth is half wide.
    merge : nodes nearer than this many times the sum of their distances to the walls are one intersection.
    max_half_width : where the walls are farther away it is a hall or yard, not a roadway [m].
    axis_length : length of centre line a branch axis is fitted to [m].
    corner_deg : a bend is an ``L`` intersection where the roadway turns by at least this within a few widths.
    bend_deg : a bend is a node of the roadway graph where the roadway turns by at least this within a few widths.
    """

    min_branch: PositiveFloat = 8.0
    min_aspect: PositiveFloat = 1.75
    open_branch: PositiveFloat = 2.0
    merge: PositiveFloat = 1.25
    max_half_width: PositiveFloat = 7.0
    axis_length: PositiveFloat = 5.0
    corner_deg: PositiveFloat = Field(default=60.0, le=180.0)
    bend_deg: PositiveFloat = Field(default=35.0, le=180.0)


class MapSettings(Settings):
    """Everything `maps.build` and `maps.observe` need; stored in the semantic map.

    cloud_radius, cloud_voxel : the dense cloud kept of each intersection [m].
    observe_range : live, intersections farther than this from every keyframe are not yet seen well enough [m].
    """

    free_space: FreeSpaceSettings = FreeSpaceSettings()
    topology: TopologySettings = TopologySettings()
    contour: ContourSettings = ContourSettings()
    cloud_radius: PositiveFloat = 15.0
    cloud_voxel: PositiveFloat = 0.15
    observe_range: PositiveFloat = 10.0

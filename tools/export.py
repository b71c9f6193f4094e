"""A semantic database for other programs: GeoJSON for maps and GIS, GraphML for graph tools."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np

from maps.road_net import Road, roads_of
from semmap import database
from semmap.crs import epsg_code
from semmap.errors import SettingsError
from semmap.files import written_whole
from semmap.geometry import Array
from semmap.intersections import SemanticMap
from tools.files import writable_file, write_text

_DECIMALS = 3
"""Of coordinates and lengths [m]; the point clouds are not better."""


def export_database(path: Path, *, geojson: Path | None, graphml: Path | None) -> SemanticMap:
    """Write the database at ``path`` as GeoJSON, as GraphML, or as both."""
    if geojson is None and graphml is None:
        raise SettingsError("nothing to write", field="export", mend="give --geojson FILE, --graphml FILE, or both")
    for out in (geojson, graphml):
        if out is not None:
            writable_file(out)
    semantic_map = database.load(path)
    if geojson is not None:
        write_text(geojson, json.dumps(geojson_of(semantic_map), allow_nan=False) + "\n")
    if graphml is not None:
        with written_whole(graphml) as temporary:
            nx.write_graphml_xml(graph_of(semantic_map), temporary, prettyprint=True)
    return semantic_map


def geojson_of(semantic_map: SemanticMap) -> dict[str, Any]:
    """A feature collection in map coordinates: points for the intersections and other nodes, lines for the roadways.

    RFC 7946 wants longitude and latitude; mine coordinates are left as they are, and the older ``crs`` member names
    the coordinate system where its EPSG code is known, which GIS programs still read.
    """
    code = epsg_code(semantic_map.crs)
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{code}"}}
    roads = roads_of(semantic_map.roadways)
    lines = [_roadway(number, road, semantic_map) for number, road in enumerate(roads)]
    return {
        "type": "FeatureCollection",
        "name": semantic_map.frame,
        **({"crs": crs} if code is not None else {}),
        "features": [*_intersections(semantic_map), *_other_nodes(semantic_map), *lines],
    }


def _feature(kind: str, geometry: str, coordinates: Array, properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "geometry": {"type": geometry, "coordinates": coordinates.round(_DECIMALS).tolist()},
        "properties": {"feature": kind, **properties},
    }


def _intersections(semantic_map: SemanticMap) -> list[dict[str, Any]]:
    c = semantic_map.columns
    rows = zip(c.id.tolist(), c.p_map, c.kind.tolist(), c.quality.tolist(), c.branch_counts.tolist(), strict=True)
    return [
        _feature(
            "intersection", "Point", p, {"id": id, "kind": kind, "quality": round(quality, 3), "branches": branches}
        )
        for id, p, kind, quality, branches in rows
    ]


def _other_nodes(semantic_map: SemanticMap) -> list[dict[str, Any]]:
    """The nodes of the graph that are no intersections."""
    graph = semantic_map.roadways
    return [
        _feature("node", "Point", graph.node_p_map[row], {"kind": str(graph.node_kind[row])})
        for row in np.flatnonzero(graph.node_intersection < 0).tolist()
    ]


def _roadway(number: int, road: Road, semantic_map: SemanticMap) -> dict[str, Any]:
    ends = [int(semantic_map.roadways.node_intersection[node]) for node in road.nodes]
    start, end = (id if id >= 0 else None for id in ends)
    properties = {"roadway": number, "from": start, "to": end, **_figures(road)}
    return _feature("roadway", "LineString", road.axis, properties)


def _figures(road: Road) -> dict[str, float]:
    """Length, width and height [m] and slope of a roadway; the height only where it is known."""
    figures = {"length_m": round(road.length, _DECIMALS), "width_m": round(road.width, _DECIMALS)}
    if road.height > 0.0:
        figures["height_m"] = round(road.height, _DECIMALS)
    return {**figures, "slope": round(road.slope, 4)}


def graph_of(semantic_map: SemanticMap) -> nx.MultiGraph:
    """The roadway graph: nodes with place and kind, and what is known of an intersection; edges with their figures."""
    roadways, c = semantic_map.roadways, semantic_map.columns
    row_of_id = {id: row for row, id in enumerate(c.id.tolist())}
    graph = nx.MultiGraph(frame=semantic_map.frame, crs=semantic_map.crs or "")
    for node, (p, id) in enumerate(zip(roadways.node_p_map.tolist(), roadways.node_intersection.tolist(), strict=True)):
        x, y, z = (round(value, _DECIMALS) for value in p)
        graph.add_node(node, x=x, y=y, z=z, kind=str(roadways.node_kind[node]))
        if id >= 0:
            row = row_of_id[id]
            type_, quality = str(c.kind[row]), round(float(c.quality[row]), 3)
            graph.nodes[node].update(intersection=id, type=type_, quality=quality, branches=int(c.branch_counts[row]))
    for number, road in enumerate(roads_of(roadways)):
        graph.add_edge(*road.nodes, key=number, **_figures(road))
    return graph


def outcome(semantic_map: SemanticMap) -> str:
    """One sentence on what was written."""
    return f"{len(semantic_map)} intersections, {len(semantic_map.roadways.edge_nodes)} roadways"

#!/usr/bin/env python3
"""Compares a centreline of `import mesh` with VMTK's of the same surface, and with a table's.

    scripts/centerline-check.py vmtk mine/mine-airway.ply mine/mine-centerline.csv vmtk.csv    (needs vmtk: Python 3.12)
    scripts/centerline-check.py compare --out DIR --vmtk NAME mine/mine-centerline.csv vmtk.csv
    scripts/centerline-check.py compare --out DIR --table NAME centerline.csv table.csv surface.ply
    scripts/centerline-check.py weld surface.ply welded.ply     (a surface with faces of no area, which import refuses)

Needs numpy and scipy. `compare` takes any number of --vmtk and --table and writes centerline.csv and centerline.md. The
surface is the one that the import wrote, or one in LPS and mm. `vmtk` runs vmtkcenterlines as it comes (cost 1/R) from
the inlet to every end of our centreline, and to every tip of the surface that our centreline leaves out; 60 to 90 CPU
seconds a mesh. Its columns: line, leaf (our point; -1: a tip that ours leaves out), group and blanked (of
vmtkbranchextractor; -1: none), x_mm, y_mm, z_mm, radius_mm. A row of line -1 is the origin of a bifurcation.
"""

import argparse
import csv
import pathlib
import re
import typing

import numpy
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

STEP_MM = 0.05  # a polyline is a row of points so far apart
THIN_MM = 0.3  # least distance of the points of VMTK's lines that are kept
TIP_MM = 6.0  # a tip of the surface so far outside of all inscribed spheres is a branch that was left out
LEAST_RADIUS_MM = 1.0  # end branches of a smaller mean radius are left out by design
GENERATIONS = ["0", "1", "2", "3", "4 and beyond", "all"]


def read_ply(path):
    """Vertices and faces of a binary PLY of triangles whose first properties are x, y, z."""
    data = path.read_bytes()
    start = data.index(b"end_header\n") + len("end_header\n")
    header = data[:start].decode()
    vertices, faces = (int(re.search(rf"element {what} (\d+)", header).group(1)) for what in ("vertex", "face"))
    kinds = re.findall(r"property (float|float32|double|float64|uchar|uint8) (\w+)\n", header.split("element face")[0])
    codes = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1"}
    kind = numpy.dtype([(name, codes[code]) for code, name in kinds])
    table = numpy.frombuffer(data, kind, vertices, start)
    corners = numpy.dtype([("count", "u1"), ("corner", "<i4", 3)])
    places = numpy.stack([table[axis].astype(float) for axis in "xyz"], axis=1)
    return places, numpy.frombuffer(data, corners, faces, start + vertices * kind.itemsize)["corner"]


def write_ply(path, vertices, faces):
    rows = numpy.empty(len(faces), numpy.dtype([("count", "u1"), ("corner", "<i4", 3)]))
    rows["count"], rows["corner"] = 3, faces
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_bytes(header.encode() + vertices.astype("<f4").tobytes() + rows.tobytes())


def welded(vertices, faces):
    """Vertices of one place are one; faces that lose a corner go."""
    vertices, place = numpy.unique(vertices, axis=0, return_inverse=True)
    faces = place.ravel()[faces]
    a, b, c = faces.T
    return vertices, faces[(a != b) & (b != c) & (c != a)]


class Tree:
    """Points with radii and parents, in the order of the file."""

    def __init__(self, path):
        with open(path, newline="") as file:
            rows = list(csv.DictReader(file))

        def of(name, kind):
            return numpy.array([kind(row[name]) for row in rows])

        self.place = numpy.stack([of(f"{axis}_mm", float) for axis in "xyz"], axis=1)
        self.radius, self.branch = of("radius_mm", float), of("branch", int)
        self.generation = of("generation", int)
        index = {int(row["id"]): k for k, row in enumerate(rows)}
        self.parent = numpy.array([index.get(int(row["parent_id"]), -1) for row in rows])
        self.children = [[] for _ in rows]
        for k, parent in enumerate(self.parent):
            if parent >= 0:
                self.children[parent].append(k)
        self.leaves = [k for k, below in enumerate(self.children) if not below]
        self.junctions = [k for k, below in enumerate(self.children) if len(below) > 1]
        self.inlet = int(numpy.flatnonzero(self.parent < 0)[0])

    def polyline(self):
        own = numpy.flatnonzero(self.parent >= 0)
        ends = numpy.zeros(len(self.place), bool)
        ends[self.leaves + [self.inlet]] = True
        return Polyline(self.place, self.radius, numpy.stack([self.parent[own], own], axis=1), ends)

    def leaf_sets(self):
        """The ends below every junction."""
        below = [set() for _ in self.place]
        for leaf in self.leaves:
            k = leaf
            while k >= 0:
                below[k].add(leaf)
                k = self.parent[k]
        return {k: frozenset(below[k]) for k in self.junctions}

    def direction_out(self, end):
        """From three points before an end, or behind the inlet, towards it."""
        k = end
        for _ in range(3):
            k = self.parent[k] if end != self.inlet else self.children[k][0]
        out = self.place[end] - self.place[k]
        return out / numpy.linalg.norm(out)


class Polyline:
    """Segments as points STEP_MM apart, each with its radius and the nearer end of its segment."""

    def __init__(self, place, radius, segments, ends):
        places, radii, owners = [place], [radius], [numpy.arange(len(place))]
        for a, b in segments:
            count = int(numpy.linalg.norm(place[b] - place[a]) / STEP_MM)
            if count > 0:
                share = numpy.arange(1, count + 1)[:, None] / (count + 1)
                places.append(place[a] + share * (place[b] - place[a]))
                radii.append(radius[a] + share[:, 0] * (radius[b] - radius[a]))
                owners.append(numpy.where(share[:, 0] < 0.5, a, b))
        self.radius, self.owner = numpy.concatenate(radii), numpy.concatenate(owners)
        self.is_end = numpy.zeros(len(self.radius), bool)
        self.is_end[: len(place)] = ends
        self.samples = cKDTree(numpy.concatenate(places))

    def nearest(self, points):
        """Distance, radius there, index of the segment's end there, and whether the point lies beyond an end."""
        distance, sample = self.samples.query(points)
        return distance, self.radius[sample], self.owner[sample], self.is_end[sample]


def left_out_tips(vertices, faces, ours):
    """The vertex farthest outside of all inscribed spheres, of each part of the surface that sticks out of them."""
    distance, near = cKDTree(ours.place).query(vertices, k=12)
    outside = distance - ours.radius[near]
    best = outside.argmin(axis=1)
    at = numpy.arange(len(vertices))
    outside, generation = outside[at, best], ours.generation[near[at, best]]
    out = outside > 0.5 * TIP_MM
    edges = numpy.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[out[edges].all(axis=1)]
    graph = coo_matrix((numpy.ones(len(edges)), edges.T), shape=(len(vertices), len(vertices)))
    part = connected_components(graph, directed=False)[1]
    tips = [v[outside[v].argmax()] for v in (numpy.flatnonzero(out & (part == p)) for p in numpy.unique(part[out]))]
    # the corners of the trachea's flat end stick out too
    return [int(v) for v in tips if outside[v] > TIP_MM and generation[v] > 0]


def thinned(line):
    """Without the points that follow another within THIN_MM, but for the last."""
    passed = numpy.concatenate([[0.0], numpy.linalg.norm(numpy.diff(line[:, :3], axis=0), axis=1).cumsum()])
    kept = [0]
    for k in range(1, len(line) - 1):
        if passed[k] - passed[kept[-1]] >= THIN_MM and passed[-1] - passed[k] >= THIN_MM:
            kept.append(k)
    return line[kept + [len(line) - 1]]


def run_vmtk(surface, centerline, out):
    import vtk
    from vmtk import vtkvmtk
    from vtk.util.numpy_support import vtk_to_numpy

    ours = Tree(centerline)
    reader = vtk.vtkPLYReader()
    reader.SetFileName(str(surface))
    normals = vtk.vtkPolyDataNormals()
    normals.SetInputConnection(reader.GetOutputPort())
    normals.SplittingOff()
    normals.ConsistencyOn()
    normals.AutoOrientNormalsOn()
    normals.Update()
    mesh = normals.GetOutput()
    vertices = vtk_to_numpy(mesh.GetPoints().GetData()).astype(float)
    faces = vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    nearest = cKDTree(vertices)

    def seed(end):
        return int(nearest.query(ours.place[end] + ours.radius[end] * ours.direction_out(end))[1])

    def id_list(ids):
        ids_of_vtk = vtk.vtkIdList()
        for k in ids:
            ids_of_vtk.InsertNextId(k)
        return ids_of_vtk

    leaves = list(ours.leaves)
    tips = left_out_tips(vertices, faces, ours)
    lines = vtkvmtk.vtkvmtkPolyDataCenterlines()
    lines.SetInputData(mesh)
    lines.SetSourceSeedIds(id_list([seed(ours.inlet)]))
    lines.SetTargetSeedIds(id_list([seed(leaf) for leaf in leaves] + tips))
    lines.SetRadiusArrayName("R")
    lines.SetCostFunction("1/R")
    lines.Update()
    everything = lines.GetOutput()
    if everything.GetNumberOfCells() != len(leaves) + len(tips):
        raise SystemExit(f"{everything.GetNumberOfCells()} lines for {len(leaves)} ends and {len(tips)} tips")

    def points_of(data, cell):
        ids = data.GetCell(cell).GetPointIds()
        ids = [ids.GetId(k) for k in range(ids.GetNumberOfIds())]
        radius = vtk_to_numpy(data.GetPointData().GetArray("R"))
        return numpy.column_stack([vtk_to_numpy(data.GetPoints().GetData())[ids], radius[ids]])

    # The branches are those of the lines to our ends alone. Fewer points than every 0.13 mm: they cost the square.
    chosen, places, radii, cells = vtk.vtkPolyData(), vtk.vtkPoints(), vtk.vtkDoubleArray(), vtk.vtkCellArray()
    radii.SetName("R")
    for cell in range(len(leaves)):
        line = thinned(points_of(everything, cell))
        cells.InsertNextCell(len(line))
        for *place, radius in line:
            cells.InsertCellPoint(places.InsertNextPoint(place))
            radii.InsertNextValue(radius)
    chosen.SetPoints(places)
    chosen.SetLines(cells)
    chosen.GetPointData().AddArray(radii)
    names = {"GroupIds": "group", "CenterlineIds": "line", "TractIds": "tract", "Blanking": "blanked"}
    split = vtkvmtk.vtkvmtkCenterlineBranchExtractor()
    split.SetInputData(chosen)
    split.SetRadiusArrayName("R")
    for method, name in names.items():
        getattr(split, f"Set{method}ArrayName")(name)
    split.Update()
    branches = split.GetOutput()
    of = {name: vtk_to_numpy(branches.GetCellData().GetArray(name)) for name in names.values()}
    origins = vtkvmtk.vtkvmtkCenterlineBifurcationReferenceSystems()
    origins.SetInputData(branches)
    origins.SetRadiusArrayName("R")
    origins.SetBlankingArrayName("blanked")
    origins.SetGroupIdsArrayName("group")
    origins.SetNormalArrayName("normal")
    origins.SetUpNormalArrayName("up")
    origins.Update()
    origins = origins.GetOutput()

    rows = []
    for cell in numpy.lexsort([of["tract"], of["line"]]):
        head = [of["line"][cell], leaves[of["line"][cell]], of["group"][cell], of["blanked"][cell]]
        rows += [head + list(point) for point in points_of(branches, cell)]
    for cell in range(len(leaves), everything.GetNumberOfCells()):
        rows += [[cell, -1, -1, -1] + list(point) for point in points_of(everything, cell)]
    groups = vtk_to_numpy(origins.GetPointData().GetArray("group"))
    for group, place in zip(groups, vtk_to_numpy(origins.GetPoints().GetData())):
        rows.append([-1, -1, group, 1] + list(place) + [0.0])
    with open(out, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow("line leaf group blanked x_mm y_mm z_mm radius_mm".split())
        writer.writerows([[int(v) for v in row[:4]] + [f"{v:.5f}" for v in row[4:]] for row in rows])


class VmtkLines:
    """What `vmtk` wrote."""

    def __init__(self, path):
        table = numpy.loadtxt(path, delimiter=",", skiprows=1)
        head = table[:, :4].astype(int)
        rows = (head[:, 0] >= 0) & (head[:, 1] >= 0)
        self.head, self.place, self.radius = head[rows], table[rows, 4:7], table[rows, 7]
        same = self.head[1:, 0] == self.head[:-1, 0]
        at = numpy.flatnonzero(same)
        ends = numpy.concatenate([[True], ~same]) | numpy.concatenate([~same, [True]])
        self.polyline = Polyline(self.place, self.radius, numpy.stack([at, at + 1], axis=1), ends)
        self.origins = {row[2]: place for row, place in zip(head, table[:, 4:7]) if row[0] < 0}
        left_out = (head[:, 0] >= 0) & (head[:, 1] < 0)
        self.left_out = [table[left_out & (head[:, 0] == k)][:, 4:] for k in numpy.unique(head[left_out, 0])]
        self.below = {}
        for _, leaf, group, blanked in self.head:
            self.below.setdefault((blanked, group), set()).add(leaf)

    def branches(self):
        return len({frozenset(leaves) for (blanked, _), leaves in self.below.items() if not blanked})

    def bifurcations(self):
        """The origin of each bifurcation by the ends below it. Where one line bends sharply VMTK cuts it too."""
        found = {}
        for (blanked, group), leaves in self.below.items():
            if blanked and len(leaves) > 1:
                found[frozenset(leaves)] = self.origins[group]
        return found


def rows_of(head, **parts):
    """A row for each generation: median, median of the size, 95 % and largest of each part's values."""
    rows = []
    for name in GENERATIONS:
        row = {**head, "generation": name}
        for part, (values, generation) in parts.items():
            if name == "all":
                chosen = values
            elif name.isdigit():
                chosen = values[generation == int(name)]
            else:
                chosen = values[generation >= 4]
            row[f"{part}_points"] = len(chosen)
            if len(chosen) > 0:
                size = numpy.abs(chosen)
                row[f"{part}_bias_mm"] = numpy.median(chosen)
                row[f"{part}_median_mm"] = numpy.median(size)
                row[f"{part}_p95_mm"] = numpy.percentile(size, 95)
                row[f"{part}_most_mm"] = size.max()
        rows.append(row)
    return rows


def beside_vmtk(name, ours_path, vmtk_path):
    """Rows by generation, and what the junctions are like. Points beyond the other's end are not compared."""
    ours, vmtk = Tree(ours_path), VmtkLines(vmtk_path)
    distance, radius, _, beyond = vmtk.polyline.nearest(ours.place)
    back, _, owner, beyond_ours = ours.polyline().nearest(vmtk.place)
    # The lines share the trunk: one of several equal points is enough.
    _, once = numpy.unique(vmtk.place.round(4), axis=0, return_index=True)
    once = once[~beyond_ours[once]]
    rows = rows_of(
        {"mesh": name, "beside": "VMTK"},
        to_other=(distance[~beyond], ours.generation[~beyond]),
        from_other=(back[once], ours.generation[owner[once]]),
        radius=((ours.radius - radius)[~beyond], ours.generation[~beyond]),
    )
    theirs, leaf_sets = vmtk.bifurcations(), ours.leaf_sets()
    matching = [k for k in ours.junctions if leaf_sets[k] in theirs]
    apart = numpy.array([numpy.linalg.norm(ours.place[k] - theirs[leaf_sets[k]]) for k in matching])
    left_out = []
    for line in vmtk.left_out:
        away, radius_of_ours, _, _ = ours.polyline().nearest(line[:, :3])
        free = line[away > radius_of_ours]
        left_out.append((numpy.linalg.norm(numpy.diff(free[:, :3], axis=0), axis=1).sum(), free[:, 3].mean()))
    return rows, {
        "mesh": name,
        "branches": (len(set(ours.branch)), vmtk.branches()),
        "junctions": (len(ours.junctions), len(theirs), len(matching)),
        "apart": apart,
        "apart_radii": apart / ours.radius[matching],
        "left_out": left_out,
    }


def distance_to_surface(vertices, faces, points):
    """To the nearest vertex, middle of an edge or of a face: some 0.01 mm too long on faces of 0.5 mm."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    samples = numpy.concatenate([vertices, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3])
    return cKDTree(samples).query(points)[0]


def matching_junctions(ours, table, inside, owner):
    """Our junction where two daughters of a junction of the table part: pairs of ours and of the table."""
    last_inside = {}
    for k in numpy.flatnonzero(inside):
        last_inside[table.branch[k]] = owner[k]

    def upwards(k):
        while k >= 0:
            yield k
            k = ours.parent[k]

    pairs = {}
    for junction in table.junctions:
        daughters = [last_inside[b] for b in (table.branch[c] for c in table.children[junction]) if b in last_inside]
        for a, b in ((a, b) for k, a in enumerate(daughters) for b in daughters[:k]):
            above = set(upwards(a))
            fork = next(k for k in upwards(b) if k in above)
            if fork in (a, b) or len(ours.children[fork]) < 2:
                continue
            apart = numpy.linalg.norm(ours.place[fork] - table.place[junction])
            pairs[fork] = min(pairs.get(fork, numpy.inf), apart)
    return pairs


class TableBranch(typing.NamedTuple):
    branch: int
    generation: int
    drawn: bool  # whether the surface has it
    wide: bool
    found: bool
    length_mm: float
    radius_mm: float  # mean, in the surface


def beside_table(name, ours_path, table_path, surface_path):
    """The same beside a table, and which of its branches are found."""
    ours, table = Tree(ours_path), Tree(table_path)
    in_surface = distance_to_surface(*read_ply(surface_path), table.place)
    distance, radius, owner, beyond = table.polyline().nearest(ours.place)
    back, _, owner_in_ours, beyond_ours = ours.polyline().nearest(table.place)
    inside = back < table.radius
    branches = []
    for branch in numpy.unique(table.branch):
        own = table.branch == branch
        # A sweep leaves out what is thin: there the surface is farther than the table's radius.
        drawn = in_surface[own].mean() < 1.2 * table.radius[own].mean()
        wide = drawn and in_surface[own].mean() >= LEAST_RADIUS_MM
        length = numpy.linalg.norm(numpy.diff(table.place[own], axis=0), axis=1).sum()
        found = inside[own].mean() >= 0.5
        generation = table.generation[own][0]
        branches.append(TableBranch(branch, generation, drawn, wide, found, length, in_surface[own].mean()))
    found = numpy.isin(table.branch, [b.branch for b in branches if b.found])
    kept = found & ~beyond_ours
    generation = table.generation[owner[~beyond]]
    rows = rows_of(
        {"mesh": name, "beside": "table"},
        to_other=(distance[~beyond], generation),
        from_other=(back[kept], table.generation[kept]),
        radius=((ours.radius - radius)[~beyond], generation),
        radius_in_surface=((ours.radius - in_surface[owner])[~beyond], generation),
    )
    matching = matching_junctions(ours, table, inside & found, owner_in_ours)
    apart = numpy.array(list(matching.values()))
    extra = [b for b in numpy.unique(ours.branch) if (distance < radius)[ours.branch == b].mean() < 0.5]
    return rows, {
        "mesh": name,
        "branches": (len(set(ours.branch)), len(branches)),
        "junctions": (len(ours.junctions), len(table.junctions), len(matching)),
        "apart": apart,
        "apart_radii": apart / ours.radius[list(matching)],
        "found": branches,
        "extra": extra,
    }


PARTS = ["to_other", "from_other", "radius", "radius_in_surface"]
FIGURES = ["points", "bias_mm", "median_mm", "p95_mm", "most_mm"]
# A distance has no sign.
COLUMNS = [f"{p}_{f}" for p in PARTS for f in FIGURES if not (f == "bias_mm" and p.endswith("other"))]


def write_csv(path, rows):
    head = ["mesh", "beside", "generation"]
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head + COLUMNS)
        for row in rows:
            figures = {c: v if isinstance(v, int) else f"{v:.3f}" for c, v in row.items() if c in COLUMNS}
            writer.writerow([row[h] for h in head] + [figures.get(c, "") for c in COLUMNS])


def triple(row, part):
    if not row.get(f"{part}_points"):
        return ""
    return " / ".join(f"{row[f'{part}_{what}_mm']:.2f}" for what in ("median", "p95", "most"))


def pair(row, part):
    if not row.get(f"{part}_points"):
        return ""
    return f"{row[f'{part}_bias_mm']:+.2f}; {row[f'{part}_median_mm']:.2f} / {row[f'{part}_p95_mm']:.2f}"


PAGE = """# The centreline beside others

mm. Written by `scripts/centerline-check.py`, whose head says how. `centerline.csv` has all figures.

## Place and radius

Distance of the points of one from the line of the other: median / 95 % / most. Radius: ours less
the other's, median; then the size of the difference, median / 95 %.

| mesh, beside | generation | ours from the other | the other from ours | radius |
|---|---|---|---|---|
{places}

{in_surface}

## Junctions

Matching: with the same ends below (VMTK), with the same daughters (table). Distance of these: median / 95 %.

| mesh | branches, ours / other | junctions, ours / other | matching | distance | distance in our radii |
|---|---|---|---|---|---|
{junctions}

## Branches that ours leaves out

Parts of the surface that reach {tip:.0f} mm or more beyond all of our inscribed spheres, measured along
VMTK's lines outside of ours:

| mesh | parts | mean radius of {least:.0f} mm or more | length, mean radius |
|---|---|---|---|
{left_out}

Branches of the table that our centreline passes through. *Wide*: with a mean radius of {least:.0f} mm or
more in the surface.

| generation | in the table | found / in the surface | found / wide | wide and missing: length, mean radius |
|---|---|---|---|---|
{found}
"""


def write_markdown(path, rows, junctions):
    def table(cells_of_rows):
        return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in cells_of_rows)

    def name(row):
        return f"{row['mesh']}, {row['beside']}"

    places = [
        [name(row), row["generation"], triple(row, "to_other"), triple(row, "from_other"), pair(row, "radius")]
        for row in rows
    ]
    in_surface = [
        f"The surface of {row['mesh']} is narrower than the table says. Our radius less the distance of the\n"
        f"table's points from the surface: {pair(row, 'radius_in_surface')}."
        for row in rows
        if row["generation"] == "all" and row.get("radius_in_surface_points")
    ]
    forks = []
    for j in junctions:
        apart, radii = (numpy.percentile(j[key], [50, 95]) for key in ("apart", "apart_radii"))
        ours, other, matching = j["junctions"]
        cells = [j["mesh"], "{} / {}".format(*j["branches"]), f"{ours} / {other}", matching]
        forks.append(cells + [f"{pair_of[0]:.2f} / {pair_of[1]:.2f}" for pair_of in (apart, radii)])
    left_out = []
    for j in [j for j in junctions if "left_out" in j]:
        parts = sorted(j["left_out"], reverse=True)
        wide = sum(radius >= LEAST_RADIUS_MM for _, radius in parts)
        said = "; ".join(f"{length:.0f}, {radius:.2f}" for length, radius in parts)
        left_out.append([j["mesh"], len(parts), wide, said])
    found = []
    for j in [j for j in junctions if "found" in j]:
        for generation in sorted({b.generation for b in j["found"]}):
            own = [b for b in j["found"] if b.generation == generation]
            groups = [b for b in own if b.drawn], [b for b in own if b.wide]
            counts = [f"{sum(b.found for b in group)} / {len(group)}" for group in groups]
            missing = "; ".join(f"{b.length_mm:.0f}, {b.radius_mm:.2f}" for b in own if b.wide and not b.found)
            found.append([generation, len(own), *counts, missing])
    path.write_text(
        PAGE.format(
            places=table(places),
            in_surface="\n".join(in_surface),
            junctions=table(forks),
            left_out=table(left_out),
            found=table(found),
            tip=TIP_MM,
            least=LEAST_RADIUS_MM,
        )
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    vmtk = commands.add_parser("vmtk", help="runs VMTK from our ends")
    for name in ("surface", "centerline", "out"):
        vmtk.add_argument(name, type=pathlib.Path)
    weld = commands.add_parser("weld", help="makes vertices of one place one")
    for name in ("surface", "out"):
        weld.add_argument(name, type=pathlib.Path)
    compare = commands.add_parser("compare", help="writes the tables")
    compare.add_argument("--out", type=pathlib.Path, required=True)
    compare.add_argument("--vmtk", nargs=3, action="append", default=[], metavar=("NAME", "OURS", "VMTK"))
    compare.add_argument("--table", nargs=4, action="append", default=[], metavar=("NAME", "OURS", "TABLE", "SURFACE"))
    arguments = parser.parse_args()
    if arguments.command == "vmtk":
        run_vmtk(arguments.surface, arguments.centerline, arguments.out)
    elif arguments.command == "weld":
        write_ply(arguments.out, *welded(*read_ply(arguments.surface)))
    else:
        results = [beside_vmtk(name, *map(pathlib.Path, files)) for name, *files in arguments.vmtk]
        results += [beside_table(name, *map(pathlib.Path, files)) for name, *files in arguments.table]
        arguments.out.mkdir(parents=True, exist_ok=True)
        rows = [row for of_mesh, _ in results for row in of_mesh]
        write_csv(arguments.out / "centerline.csv", rows)
        write_markdown(arguments.out / "centerline.md", rows, [junctions for _, junctions in results])


if __name__ == "__main__":
    main()

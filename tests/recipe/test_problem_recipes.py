"""Recipes of any problem: what they give, and the one sentence each wrong one gets."""

import hashlib
import json
import pickle
import tomllib

import numpy as np
import pytest
import skfem

from surrofe2.base.errors import FileError, InputError
from surrofe2.macro import simulate
from surrofe2.problem import (
    BodyForce,
    Circle,
    Corner,
    Fixed,
    Foundation,
    InitialVelocity,
    NodeAt,
    Plane,
    PointForce,
    PrescribedMotion,
    Pressure,
    Problem,
    RigidBody,
    Symmetry,
    Traction,
    rectangle,
)
from surrofe2.problem.amplitude import Constant, Pulse, Ramp, Sine, Table
from surrofe2.problem.mesh import check_mesh, nodes_on
from surrofe2.recipe.recipe import load_recipe, make_recipe
from surrofe2.store.meshes import load_mesh
from tests.laws import KelvinVoigt
from tests.store.gmsh_files import QUADS

RECIPE = """
[range]
stretch = [0.95, 1.05]
shear = 0.05
rate = 0.01

[mesh]
width = 200.0
height = 100.0
elements = [4, 2]

[mesh.boundaries.patch]
box = [0.0, 100.0, 100.0, 100.0]
[mesh.boundaries.outside]
half_plane = { through = [200.0, 0.0], normal = [1.0, 0.0] }
[mesh.regions.core]
circle = { centre = [100.0, 50.0], radius = 40.0 }

[conditions.clamp]
kind = "fixed"
on = "left"

[conditions.mirror]
kind = "symmetry"
on = "bottom"

[conditions.pull]
kind = "prescribed_motion"
on = "outside"
displacement = [4.0, "free"]
amplitude = { kind = "ramp", end = 10.0, smooth = true }

[conditions.wind]
kind = "traction"
on = "top"
traction = [1.0, 0]
amplitude = [[0, 0], [5, 1.0], [6, 0]]

[conditions.turgor]
kind = "pressure"
on = "patch"
pressure = 0.1
amplitude = { kind = "sine", frequency = 0.1 }

[conditions.weight]
kind = "body_force"
on = "core"
acceleration = [0.0, -0.1]
amplitude = 0.5

[conditions.soil]
kind = "foundation"
on = "bottom"
stiffness = 3.0
components = "x"

[conditions.nail]
kind = "fixed"
on = { point = [200.0, 0.0] }
components = "y"

[conditions.needle]
kind = "point_force"
on = { point = [200.0, 100.0] }
force = [0.0, -2.0]

[conditions.throw]
kind = "initial_velocity"
velocity = [0.0, -1.0]

[bodies.plate]
plane = { normal = [0.0, -1.0] }
on = "top"
position = [0.0, 110.0]
displacement = [0.0, -8.0]
amplitude = { kind = "pulse", length = 9.0 }

[bodies.ball]
circle = { radius = 5.0 }
on = "top"
position = [100.0, 120.0]
mass = 2.0
velocity = [0.0, -3.0]

[bodies.blade]
corner = { axis = [0.0, 1.0], angle = 30.0, radius = 2.0 }
on = "top"
position = [10.0, 104.0]
friction = 0.3

[watch]
tip = [200.0, 50.0]
middle = [100.0, 50.0]

[time]
duration = 20.0
frames = 5
"""


@pytest.fixture
def changed(tmp_path):
    """changed(old, new): the path of the recipe above with a part replaced."""

    def change(old="", new=""):
        assert old in RECIPE
        path = tmp_path / "tissue.toml"
        path.write_text(RECIPE.replace(old, new, 1), encoding="utf-8")
        return path

    return change


def refusal(path, error=InputError):
    with pytest.raises(error) as caught:
        load_recipe(path).problem()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_every_kind_of_condition_body_and_part(changed):
    recipe = load_recipe(changed())
    problem = recipe.problem()
    assert problem.conditions == (
        Fixed(name="clamp", on="left"),
        Symmetry(name="mirror", on="bottom"),
        PrescribedMotion(
            name="pull", on="outside", displacement=(4.0, None),
            amplitude=Ramp(end=10.0, smooth=True),
        ),
        Traction(
            name="wind", on="top", traction=(1.0, 0.0),
            amplitude=Table(points=((0.0, 0.0), (5.0, 1.0), (6.0, 0.0))),
        ),
        Pressure(name="turgor", on="patch", pressure=0.1, amplitude=Sine(frequency=0.1)),
        BodyForce(
            name="weight", on="core", acceleration=(0.0, -0.1), amplitude=Constant(value=0.5)
        ),
        Foundation(name="soil", on="bottom", stiffness=3.0, components="x"),
        Fixed(name="nail", on=NodeAt((200.0, 0.0)), components="y"),
        PointForce(name="needle", on=NodeAt((200.0, 100.0)), force=(0.0, -2.0)),
        InitialVelocity(name="throw", velocity=(0.0, -1.0)),
    )  # fmt: skip
    plate, ball, blade = problem.bodies
    assert plate == RigidBody(
        name="plate", shape=Plane(normal=(0.0, -1.0)), on="top", position=(0.0, 110.0),
        displacement=(0.0, -8.0), amplitude=Pulse(length=9.0),
    )  # fmt: skip
    assert (ball.shape, ball.mass) == (Circle(radius=5.0), 2.0)
    assert (blade.shape.angle, blade.friction) == (30.0, 0.3)
    assert isinstance(blade.shape, Corner)
    mesh = problem.mesh
    assert mesh.nelements == 8
    sides = {name: len(each) for name, each in mesh.boundaries.items()}
    assert sides == {"left": 2, "right": 2, "bottom": 4, "top": 4, "patch": 2, "outside": 2}
    np.testing.assert_array_equal(mesh.subdomains["core"], [2, 3, 4, 5])
    assert list(problem.watched) == ["tip", "middle"]
    assert (problem.duration, problem.output_interval) == (20.0, 0.04)
    assert recipe.macro.frames == 5
    assert recipe.duration == 20.0


def test_the_whole_problem_is_in_its_provenance_and_comes_back(changed):
    recipe = load_recipe(changed())
    stored = json.loads(json.dumps(recipe.to_dict(), allow_nan=False))
    sections = {name: stored[name] for name in ("mesh", "conditions", "bodies", "watch", "time")}
    assert sections["mesh"].pop("sha256") is None
    back = make_recipe(sections)
    assert all(getattr(back, name) == getattr(recipe, name) for name in sections)
    assert "load" not in stored


def test_a_recipe_comes_back_from_its_text(changed):
    recipe = load_recipe(changed("[conditions.wind]", '[conditions."wind, \\"µ\\""]'))
    text = recipe.to_toml(None, {None: "cells.h5"})
    back = make_recipe(tomllib.loads(text))
    for name in ("mesh", "conditions", "bodies", "watch", "macro"):
        assert getattr(back, name) == getattr(recipe, name)
    assert back.cells[None].training_file == "cells.h5"


def test_conditions_may_be_a_list():
    table = tomllib.loads(RECIPE)
    table["conditions"] = [
        {"kind": "fixed", "on": "left"},
        {"kind": "body_force", "acceleration": [0, -1], "name": "g"},
    ]
    names = list(make_recipe(table).to_dict()["conditions"])
    assert names == ["fixed left", "g"]


def test_a_mesh_file_is_relative_to_the_recipe_and_told_by_its_digest(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "leaf.msh").write_text(QUADS, encoding="utf-8")
    path = tmp_path / "leaf.toml"
    path.write_text(
        "[range]\nstretch = [0.9, 1.1]\nshear = 0.1\nrate = 0.1\n"
        '[mesh]\nfile = "meshes/leaf.msh"\nlength_unit = "mm"\n'
        '[conditions.hold]\nkind = "fixed"\non = "left"\n'
        '[conditions.pull]\nkind = "traction"\non = "rigth"\ntraction = [1, 0]\n',
        encoding="utf-8",
    )
    assert refusal(path) == (
        "leaf.toml: conditions.pull.on: rigth; no such boundary; did you mean right? known are "
        "left, right"
    )
    path.write_text(path.read_text().replace("rigth", "right"), encoding="utf-8")
    recipe = load_recipe(path)
    assert recipe.problem().mesh.p.max(axis=1).tolist() == [2000.0, 1000.0]
    stored = recipe.to_dict()["mesh"]
    assert stored["sha256"] == hashlib.sha256(QUADS.encode()).hexdigest()
    assert stored["file"] == "meshes/leaf.msh"
    path.write_text(path.read_text().replace("leaf.msh", "none.msh"), encoding="utf-8")
    none = tmp_path / "meshes" / "none.msh"
    assert refusal(path, FileError) == (
        f"leaf.toml: mesh.file: {none}: cannot be read: No such file or directory"
    )


RECT = "width = 200.0\nheight = 100.0\nelements = [4, 2]\n"


BOX = "box = [0.0, 100.0, 100.0, 100.0]"


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("width = 200.0", "wdith = 200.0", "mesh.wdith: unknown key; did you mean width? known"),
        ("elements = [4, 2]", "elements = [40000, 20000]", "mesh.elements: [40000, 20000]; there"),
        ("elements = [4, 2]", 'length_unit = "mm"\nelements = [4, 2]', "mesh.length_unit: 'mm'; "),
        ("[mesh]\n" + RECT, "", "mesh.width: missing; a rectangle or a mesh.file must be given"),
        (RECT, RECT + 'file = "leaf.msh"\n', "mesh.width: 200.0; a mesh from a file has its own"),
        (BOX, "box = [0.0, 1.0, 2.0]", "mesh.boundaries.patch.box: [0.0, 1.0, 2.0]; it must be a"),
        (BOX, "box = [10.0, 90.0, 20.0, 100.0]", "mesh.boundaries.patch: Box(low=(10.0, 90.0), hi"),
        (BOX, "disc = 1", "mesh.boundaries.patch.disc: unknown key; known are box, circle, half_p"),
        ("boundaries.patch", "boundaries.top", "mesh.boundaries.top: the mesh has one of that na"),
        ("centre = [100.0, 50.0], radius = 40.0", "centre = [0.0, 0.0], radius = 4.0",
         "mesh.regions.core: Disc(centre=(0.0, 0.0), radius=4.0); it must hold the centre of an"),
        ('kind = "traction"', 'kind = "tracton"', "conditions.wind.kind: 'tracton': unknown kind;"),
        ('on = "top"\ntraction', 'on = "tpo"\ntraction', "conditions.wind.on: tpo; no such bounda"),
        ("point = [200.0, 0.0]", "point = [190.0, 0.0]", "conditions.nail.on.point: [190.0, 0.0]; "
         "no node of the mesh is within 0.0002 µm of it; the nearest is at (200, 0) µm, 10 µm aw"),
        ("point = [200.0, 0.0]", "points = [200.0, 0.0]", "conditions.nail.on.points: unknown key"),
        ('on = "top"\ntraction', "on = { point = [0, 0] }\ntraction", "conditions.wind.on: {'point"
         "': [0, 0]}; traction does not act on a point; fixed, prescribed_motion, point_force do"),
        ('kind = "traction"\non = "top"', "kind = []\non = { point = [0, 0] }",
         "conditions.wind.kind: []: unknown kind; known are "),
        (BOX, "box = [0, 0, 0, 0]", "mesh.boundaries.patch: Box(low=(0.0, 0.0), high=(0.0, 0.0)); "
         "it must hold both ends of an outer side; a condition acts on the one node in it by on ="),
        ('4.0, "free"]', '4.0, "loose"]', "conditions.pull.displacement[1]: 'loose'; it must be a"),
        ('[4.0, "free"]', '["free", "free"]', "conditions.pull.displacement: both components are "),
        ("[6, 0]]", '[6, "0"]]', "conditions.wind.amplitude.points[2][1]: '0'; it must be a numbe"),
        ("[conditions.throw]", '[conditions.fling]\nkind = "initial_velocity"\nvelocity = [1, 0]\n'
         "[conditions.throw]", "problem: 2 initial velocities on the whole mesh; give one"),
        ("circle = { radius = 5.0 }", "circle = { radius = 5.0 }\nplane = { normal = [0, 1] }",
         "bodies.ball: plane and circle; it must have exactly one of plane, circle, corner"),
        ("mass = 2.0", "mass = 2.0\ndisplacement = [1, 0]", "bodies.ball: mass 2.0 and displaceme"),
        ("mass = 2.0", "mass = 2.0\namplitude = 0.5", "bodies.ball.amplitude: 0.5; it is of a dis"),
        ("tip = [200.0, 50.0]", "tip = [201.0, 50.0]", "watch.tip: (201, 50) µm; it must lie with"),
        ("frames = 5", "output_interval = 1e-6", "problem.output_interval: 1e-06; it must be fin"),
        ("[time]", "[load]\nwidth = 9.0\n[time]", "load: [load] states the paper's bar, [mesh] an"),
        ("[time]", "[macro]\nelements = [4, 4]\n[time]", "macro.elements: [4, 4]; it stands in [m"),
    ],
)  # fmt: skip
def test_a_wrong_recipe_gets_one_sentence(changed, old, new, sentence):
    assert refusal(changed(old, new)).startswith(f"tissue.toml: {sentence}")


def test_all_faults_of_a_recipe_are_data_of_one_error(changed):
    path = changed('stiffness = 3.0\ncomponents = "x"', 'stiffness = -3.0\ncomponents = "z"')
    text = path.read_text(encoding="utf-8").replace("radius = 5.0", "radius = 0.0, centre = 1")
    text = text.replace("rate = 0.01", 'rate = "fast"\n[lood]').replace("end = 10.0", "end = -1.0")
    path.write_text(text.replace("tip = [200.0, 50.0]", "tip = 3"), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_recipe(path)
    faults = caught.value.faults
    assert [fault.where for fault in faults] == [
        "lood",
        "conditions.pull.amplitude.end",
        "conditions.soil.stiffness",
        "conditions.soil.components",
        "bodies.ball.circle.radius",
        "bodies.ball.circle.centre",
        "watch.tip",
        "range.rate",
    ]
    assert all(str(fault) == f"{fault.where}: {fault.problem}" for fault in faults)
    assert str(caught.value) == f"tissue.toml: {faults[0]}"
    assert pickle.loads(pickle.dumps(faults[1])).where == "conditions.pull.amplitude.end"


UNIT = {"width": 1.0, "height": 1.0, "elements": [1, 1]}


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ({"conditions": {}}, "mesh: missing; [conditions] needs the section [mesh]"),
        ({"mesh": UNIT}, "conditions: missing; something must hold or move the tissue"),
        ({"mesh": UNIT, "conditions": [{"kind": "fixed", "on": "left"}] * 2},
         "conditions[1]: a second one called fixed left; give it another name"),
        ({"mesh": UNIT, "conditions": {"c": {"kind": "fixed", "on": "left"}}, "time": 0},
         "time: 0; it must be a section [time]"),
        ({"mesh": UNIT, "conditions": [3]}, "conditions[0]: 3; it must be a table of entries"),
    ],
)  # fmt: skip
def test_wrong_tables(table, sentence):
    whole = {"range": {"stretch": [0.9, 1.1], "shear": 0.1, "rate": 0.1}, **table}
    with pytest.raises(InputError) as caught:
        make_recipe(whole)
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("shape", "position", "depth"),
    [
        (Plane(normal=(0.0, -1.0)), (0.0, 95.0), 5),
        (Plane(normal=(0.0, 1.0)), (0.0, 300.0), 200),
        (Circle(radius=9.0), (50.0, 100.0), 9),
    ],
)
def test_a_body_that_begins_inside_the_tissue_is_refused(shape, position, depth):
    body = RigidBody(name="lid", shape=shape, on="top", position=position)
    mesh = rectangle(200.0, 100.0, (2, 1))
    problem = Problem(mesh=mesh, conditions=(Fixed(on="bottom"),), bodies=(body,))
    with pytest.raises(InputError) as caught:
        simulate(problem, KelvinVoigt())
    told = f"bodies.lid.position: {[*position]}; the tissue begins {depth} µm inside it, at ("
    assert str(caught.value).startswith(told)


def test_wrong_calls_get_a_sentence():
    mesh = rectangle(2.0, 1.0, (2, 1))
    with pytest.raises(InputError, match=r"mesh.width: -2.0; it must be positive and finite"):
        rectangle(-2.0, 1.0, (2, 1))
    with pytest.raises(
        InputError, match=r"mesh.elements: a very long list; there must be at least"
    ):
        rectangle(2.0, 1.0, (10**5000, 1))
    with pytest.raises(InputError, match=r"mesh: 2 elements of the same nodes at \(0.5, 0.5\) µm"):
        check_mesh(skfem.MeshQuad1(mesh.p, np.concatenate([mesh.t, mesh.t[:, :1]], axis=1)))
    with pytest.raises(InputError, match="left; the mesh has no boundary or region with a name"):
        nodes_on(skfem.MeshQuad1(mesh.p, mesh.t), "left")
    with pytest.raises(InputError, match="length_unit: 'cm'; it must be one of µm, um, mm, m"):
        load_mesh("leaf.msh", "cm")

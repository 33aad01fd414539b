"""The problem that is computed, for finite elements and for a full tissue of particles alike.

Reading order: mesh (and its parts); amplitude (factors in time), contact_law, rigid_bodies;
conditions (what holds and loads a tissue), problem (all of it, and what is held), bar (of the
paper).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.problem.bar import LoadCase
    from surrofe2.problem.conditions import (
        BodyForce,
        Fixed,
        Foundation,
        InitialVelocity,
        PointForce,
        PrescribedMotion,
        Pressure,
        Surface,
        Symmetry,
        Traction,
    )
    from surrofe2.problem.mesh import (
        Box,
        Disc,
        HalfPlane,
        NodeAt,
        rectangle,
        with_boundaries,
        with_regions,
    )
    from surrofe2.problem.problem import Problem
    from surrofe2.problem.rigid_bodies import Circle, Corner, Plane, RigidBody

__getattr__, __dir__ = public_names(__name__)

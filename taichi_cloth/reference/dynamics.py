"""Motion of a scene's cloth in float64: velocity Verlet in drift–kick–drift form with short steps, of second order.

    x½ = x + h/2·v;   v' = v + h·a(x½, …);   x' = x½ + h/2·v'          (Hairer, Lubich and Wanner 2003, eq. 1.5)

Velocity-dependent forces keep the order: damping and dashpots are solved implicitly at the mean velocity, and the air
sees a velocity predicted for the middle of the step. Contact, ties and leashes are constraints on v' and x', of first
order in h where they start to act.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mesh.from_scene import holder_of
from ..mesh.tethers import tethers
from ..scene.model import FRAME_SECONDS, Capsule, Scene, Sphere
from .air import air_of
from .contact import Obstacle, obstacles_of, onto_margin, push_of, touch
from .poses import Pose, pose
from .springs import Bools, Floats, Ints, spring_model
from .triangles import TriangleContact

CG_TOLERANCE, MOST_ROUNDS = 1e-8, 500  # of the residual; of the dashpots' equations


@dataclass(frozen=True, eq=False)
class Tie:
    """How far each particle may be from a pin, or from where it started."""

    pins: Ints | None  # (N,)
    start: Floats  # [m] (3, N)
    reach: Floats  # [m] (N,)

    def places(self, x: Floats) -> Floats:
        """Of its other end [m], (3, N)."""
        return self.start if self.pins is None else x[:, self.pins]

    def velocity(self, v: Floats) -> Floats | float:
        """Of its other end [m/s]."""
        return 0.0 if self.pins is None else v[:, self.pins]


class Motion:
    """A run of one scene; `x` and `v` are places [m] and velocities [m/s], (3, N)."""

    def __init__(self, scene: Scene, steps: int, shake: Floats | float = 0.0) -> None:
        """`steps` a frame; `shake` [m] is added to where free particles start, (3, N)."""
        self._scene = scene
        self._model = model = spring_model(scene)
        self._air = air_of(scene, model)
        self._h = FRAME_SECONDS / steps
        self._steps, self._step = steps, 0
        self._bodies = obstacles_of(scene)
        holder = holder_of(scene, model.topology)
        self._grips = [(grip, np.flatnonzero(holder == k)) for k, grip in enumerate(scene.grips)]
        self._held = [pose(grip, 0.0).local(model.start[:, which]) for grip, which in self._grips]
        self._free = model.free
        self._triangle_contacts = self._triangle_contacts_of()
        self._ties = self._ties_of()
        self._gained = np.zeros_like(model.start)  # [m/s] in the last step by forces: a guess of what comes next
        self.x = model.start + shake * self._free
        self.v = np.zeros_like(self.x)

    def _ties_of(self) -> list[Tie]:
        """Tethers and leashes."""
        model, found = self._model, []
        if self._scene.tethers is not None:
            for pins, reach in zip(*tethers(model.topology), strict=True):
                found.append(Tie(pins.astype(np.int64), model.start, reach * self._scene.tethers.slack))
        if model.topology.leash is not None:
            found.append(Tie(None, model.start, model.topology.leash))
        return found

    def _triangle_contacts_of(self) -> list[TriangleContact]:
        """Of the colliders that keep whole triangles out."""
        model, scene = self._model, self._scene
        corners, inverse_mass = model.topology.triangles.T.astype(np.int64), self._free / model.mass
        bodies: list[Sphere | Capsule] = [*scene.spheres, *scene.capsules]
        return [TriangleContact(one, corners, inverse_mass) for one in bodies if one.against == "triangles"]

    def frame(self) -> Floats:
        """Advances by one frame; places then [m], (N, 3)."""
        for _ in range(self._steps):
            self._advance()
        return self.x.T.copy()

    @property
    def strain(self) -> float:
        """Largest one of all springs."""
        return float(self._model.strains(self.x).max(initial=0.0))

    def _advance(self) -> None:
        h, model = self._h, self._model
        middle, end = (self._step + 0.5) * h, (self._step + 1) * h
        self._step += 1
        x = self.x + h / 2 * self.v
        v = self.v.copy()
        self._lead(x, v, middle)
        force = model.elastic(x) + model.weight()
        if self._air is not None:
            force += self._air.force(x, v + self._gained / 2, middle)
        for body in self._bodies:
            if body.collider.response == "repulsion":
                at, density = body.pose(middle), self._scene.cloth.area_density
                force += model.mass / h * push_of(body, x, v, at, h, density)
        self._gained = self._gain(x, v, force)
        v = v + self._gained
        self._end(x, v, end)

    def _lead(self, x: Floats, v: Floats, seconds: float) -> None:
        """Puts held particles where their grips are, in place."""
        for (grip, which), local in zip(self._grips, self._held, strict=True):
            at = pose(grip, seconds)
            x[:, which] = at.center[:, None] + at.axes @ local
            v[:, which] = at.surface_velocity(x[:, which])

    def _gain(self, x: Floats, v: Floats, force: Floats) -> Floats:
        """Change of velocity in a step: that of free particles by all forces, with damping at the mean velocity."""
        h, model = self._h, self._model
        slowed = h / 2 * self._scene.solver.damping
        right = (h * force - 2 * slowed * model.mass * v) * self._free
        if model.damping_time == 0:
            gained: Floats = right / (model.mass * (1 + slowed))
            return gained
        gap = model.gaps(x)[:, : len(model.rest)]
        length = np.sqrt((gap * gap).sum(axis=0))
        dashpots = gap / length * np.sqrt(model.active(length) * model.damping_time)
        a, b = model.ends[0, : len(model.rest)], model.ends[1, : len(model.rest)]
        right += h * self._resist(dashpots, a, b, v) * self._free
        return self._implicit(dashpots, a, b, model.mass * (1 + slowed), right)

    def _resist(self, dashpots: Floats, a: Ints, b: Ints, v: Floats) -> Floats:
        """Force of the dashpots [N], (3, N)."""
        rate = ((v.take(b, axis=1) - v.take(a, axis=1)) * dashpots).sum(axis=0)
        pull = dashpots * rate
        both, ends = np.concatenate([pull, -pull], axis=1), np.concatenate([a, b])
        return np.stack([np.bincount(ends, part, v.shape[1]) for part in both])

    def _implicit(self, dashpots: Floats, a: Ints, b: Ints, mass: Floats, right: Floats) -> Floats:
        """u of (mass − h/2·∂resist/∂v)·u = right, by conjugate gradients from the last step's."""

        def left(u: Floats) -> Floats:
            found: Floats = (mass * u - self._h / 2 * self._resist(dashpots, a, b, u)) * self._free
            return found

        ends, count = np.concatenate([a, b]), len(mass)
        squares = np.concatenate([dashpots**2, dashpots**2], axis=1)
        diagonal = mass + self._h / 2 * np.stack([np.bincount(ends, part, count) for part in squares])
        u = self._gained.copy()
        residual = right - left(u)
        enough = CG_TOLERANCE**2 * float((right * right / diagonal).sum())
        way = z = residual / diagonal
        now = float((residual * z).sum())
        for _ in range(MOST_ROUNDS):
            if now <= enough:
                return u
            turned = left(way)
            share = now / float((way * turned).sum())
            u += share * way
            residual -= share * turned
            z = residual / diagonal
            before, now = now, float((residual * z).sum())
            way = z + now / before * way
        raise ArithmeticError("the dashpots' equations are not solved")

    def _end(self, x: Floats, v: Floats, seconds: float) -> None:
        """The second drift, with what constrains where it ends."""
        h = self._h
        fastest = float(np.sqrt(max((self.v**2).sum(axis=0).max(), (v**2).sum(axis=0).max())))
        ends = x + h / 2 * v
        self._lead(ends, v, seconds)
        for tie in self._ties:
            away, over = self._beyond(tie, ends)
            pulled = np.maximum(((v - tie.velocity(v)) * away).sum(axis=0), 0.0) * (over > 0)
            v -= pulled * away * self._free
        touched: list[tuple[Obstacle, Pose, Bools]] = []
        for body in self._bodies:
            if body.collider.response != "repulsion" and not body.far(fastest, h):
                at = body.pose(seconds)
                which, change = touch(body, x + h / 2 * v, v, at)
                which &= self._free
                v += change * self._free
                if which.any() and body.collider.response == "projection":
                    touched.append((body, at, which))
        ends = x + h / 2 * v
        stopped = [contact.stop(ends, v, seconds) for contact in self._triangle_contacts]
        x = x + h / 2 * v
        self._lead(x, v, seconds)
        for tie in self._ties:
            away, over = self._beyond(tie, x)
            x -= np.maximum(over, 0.0) * away * self._free
        for body, at, which in touched:
            x = np.where(which, onto_margin(body, x, at), x)
        for contact, triangles in zip(self._triangle_contacts, stopped, strict=True):
            contact.put_out(x, seconds, triangles)
        self.x, self.v = x, v

    def _beyond(self, tie: Tie, x: Floats) -> tuple[Floats, Floats]:
        """Direction from the other end of a tie (3, N), and how much farther away a particle is than allowed, (N,)."""
        gap = x - tie.places(x)
        long = np.sqrt((gap * gap).sum(axis=0))
        return gap / np.where(long > 0, long, 1.0), long - tie.reach

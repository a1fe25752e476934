"""Group II of Li et al. (2020) in Taichi, on one thread: the scene, model, particles and mesh of speed.rs.

    python taichi_group_2.py [--regime warm_plug] [--precision f32] [--steps 1000] [--strains closed] [--mesh 0.05]

Quadratic B-splines, APIC, the stress in its moving-least-squares form; Hencky elasticity; cohesive Cam clay with the
associative return; Coulomb friction at the nodes inside of the bed. `--strains closed` keeps b - I and takes principal strains
in closed form as firn does; `svd` keeps F and takes Taichi's own singular value decomposition, as its examples do. There is no
limiter of affine motion. The grid is a dense window around the block, wide enough for the steps. One line of JSON; the
compilation is not timed.
"""

import argparse
import json
import math
import time

import taichi as ti

REGIMES = {
    "cold_dense": (0.5, 0.0, 1.0, 3e3),
    "warm_shear": (1.5, 0.3, 1.0, 30e3),
    "sliding_slab": (1.5, 0.5, 1.0, 42e3),
    "warm_plug": (0.5, 1.0, 0.1, 12e3),
}

parser = argparse.ArgumentParser()
parser.add_argument("--regime", default="warm_plug", choices=REGIMES)
parser.add_argument("--precision", default="f32", choices=["f32", "f64"])
parser.add_argument("--steps", type=int, default=1000)
parser.add_argument("--strains", default="closed", choices=["closed", "svd"])
parser.add_argument("--mesh", type=float, default=0.05)
options = parser.parse_args()

real = ti.f32 if options.precision == "f32" else ti.f64
ti.init(
    arch=ti.cpu, default_fp=real, cpu_max_num_threads=1, fast_math=True, log_level=ti.ERROR, offline_cache=False
)

# scene: lengths in m, the slope ends at (-r sin theta, r - r cos theta), then the arc, then the flat from x = 0
THETA, RADIUS, LENGTH, THICKNESS = math.radians(40), 10.0, 12.0, 2.0
MESH = options.mesh
STEP = 2.3e-4 * MESH / 0.05
GRAVITY, BED_FRICTION = 9.81, 0.5
DENSITY, YOUNG, POISSON = 250.0, 3e6, 0.3
SHEAR = YOUNG / (2 * (1 + POISSON))
LAME = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
BULK = LAME + SHEAR
FRICTION, COHESION, HARDENING, STRENGTH = REGIMES[options.regime]
RELEASED = -math.asinh(STRENGTH / BULK) / HARDENING
Q_FACTOR = math.sqrt(1.5)
RATIO = 2 * SHEAR * Q_FACTOR**2 * (1 + 2 * COHESION) / (BULK * FRICTION**2)
WEAKEST = 1e-9 * BULK

centre_x = -65.0
centre_z = 65.0 * math.tan(THETA) - (RADIUS - 0.5 * THICKNESS) / math.cos(THETA) + RADIUS
along, across = (math.cos(THETA), -math.sin(THETA)), (math.sin(THETA), math.cos(THETA))
spacing = 0.5 * MESH
count_along, count_across = round(LENGTH / spacing), round(THICKNESS / spacing)
count = count_along * count_across

# the window: the block, and what it slides at most in the steps, and four cells
duration = options.steps * STEP
slides = 0.5 * GRAVITY * duration**2
half_x = 0.5 * (LENGTH * math.cos(THETA) + THICKNESS * math.sin(THETA))
half_z = 0.5 * (LENGTH * math.sin(THETA) + THICKNESS * math.cos(THETA))
first_column = math.floor((centre_x - half_x) / MESH) - 4
first_row = math.floor((centre_z - half_z - slides) / MESH) - 4
columns = math.ceil((centre_x + half_x + slides) / MESH) + 4 - first_column
rows = math.ceil((centre_z + half_z) / MESH) + 4 - first_row

position = ti.Vector.field(2, real, count)  # in cells from the window's corner
velocity = ti.Vector.field(2, real, count)  # cells a step
affine = ti.Matrix.field(2, 2, real, count)  # dt grad v
elastic = ti.Matrix.field(2, 2, real, count)  # b - I, or F
plastic = ti.field(real, count)
momentum = ti.Vector.field(2, real, (columns, rows))
mass = ti.field(real, (columns, rows))
bed_row = ti.field(ti.i32, columns)
bed_normal = ti.Vector.field(2, real, columns)

CLOSED = options.strains == "closed"
# stress in the units of the dynamics: particles have the mass 1, lengths are cells, times are steps
SCALE = 4 * STEP**2 / (DENSITY * MESH**2)
FALL = GRAVITY * STEP**2 / MESH
HALLEY_STEPS = 2 if options.precision == "f32" else 4


def bed(x):
    """Height of the bed and its normal."""
    toe = -RADIUS * math.sin(THETA)
    if x < toe:
        return RADIUS * (1 - math.cos(THETA)) - (x - toe) * math.tan(THETA), across
    if x < 0:
        down = math.sqrt(RADIUS**2 - x**2)
        return RADIUS - down, (-x / RADIUS, down / RADIUS)
    return 0.0, (0.0, 1.0)


def release():
    for column in range(columns):
        height, normal = bed((first_column + column) * MESH)
        bed_row[column] = math.floor(height / MESH) - first_row
        bed_normal[column] = normal
    for p in range(count):
        s = (p // count_across + 0.5) * spacing - 0.5 * LENGTH
        n = (p % count_across + 0.5) * spacing - 0.5 * THICKNESS
        x, z = (centre + s * a + n * b for centre, a, b in zip((centre_x, centre_z), along, across))
        position[p] = (x / MESH - first_column, z / MESH - first_row)
    velocity.fill(0)
    affine.fill(0)
    elastic.fill(0)
    if not CLOSED:
        for p in range(count):
            elastic[p] = [[1, 0], [0, 1]]
    plastic.fill(RELEASED)


@ti.func
def sinh(x):
    e = ti.exp(x)
    return 0.5 * (e - 1 / e)


@ti.func
def closest(volumetric, deviatoric, strength):
    """Elastic volumetric strain and share of the deviatoric one at the closest point of the yield surface."""
    half_axis, centre = 0.5 * (1 + COHESION) * strength, 0.5 * (1 - COHESION) * strength
    p = -BULK * volumetric - centre
    q = Q_FACTOR * 2 * ti.sqrt(2.0) * SHEAR * ti.sqrt(1.0 + 2 * COHESION) / FRICTION * ti.abs(deviatoric)
    scale_p = ti.max(ti.abs(p), half_axis, half_axis + (q - half_axis) / RATIO)
    scale_q = half_axis + RATIO * (scale_p - half_axis)
    p, q, k, t = p / scale_p, q / scale_q, RATIO * scale_p / scale_q, ti.cast(0, real)
    for _ in ti.static(range(HALLEY_STEPS)):
        a, b = 1 + t, 1 + k * t
        x, y = (p * b) ** 2, (q * a) ** 2
        n, d = x + y, a * b
        slope, bend = x * b + k * y * a, x * b * b + k * k * y * a * a
        excess = ti.sqrt(n) - d
        t = ti.max(t + n * slope * d * excess / (slope**2 * d - 1.5 * excess * (bend * n - slope**2)), 0)
    a, b = 1 + t, 1 + k * t
    onto = 1 / ti.sqrt((p * b) ** 2 + (q * a) ** 2)
    return -(half_axis * p * b * onto + centre) / BULK, half_axis / scale_q * a * onto


@ti.func
def yields(volumetric, deviatoric, strength):
    p = -BULK * volumetric
    q = Q_FACTOR * 2 * ti.sqrt(2.0) * SHEAR * deviatoric
    return (1 + 2 * COHESION) * q * q + FRICTION**2 * (p + COHESION * strength) * (p - strength) > 0


@ti.func
def returned(p, volumetric, deviatoric):
    """Elastic strains after the return of particle p."""
    strength = BULK * sinh(HARDENING * ti.max(-plastic[p], 0))
    v, share = volumetric, ti.cast(1, real)
    if yields(volumetric, deviatoric, strength):
        v, share = ti.cast(0, real), ti.cast(0, real)
        if strength > WEAKEST:
            v, share = closest(volumetric, deviatoric, strength)
        plastic[p] += volumetric - v
    return v, share * deviatoric


@ti.func
def stress(p):
    """Deforms particle p; its Kirchhoff stress."""
    tau = ti.Matrix.zero(real, 2, 2)
    identity = ti.Matrix.identity(real, 2)
    if ti.static(CLOSED):
        low = affine[p]
        n = low + low @ elastic[p]
        b = elastic[p] + n + n.transpose() + n @ low.transpose()
        mean, half = 0.5 * (b[0, 0] + b[1, 1]), 0.5 * (b[0, 0] - b[1, 1])
        radius = ti.sqrt(half * half + b[0, 1] * b[0, 1])
        # as firn does: logarithms of what is near 1 by atanh, whose series is short for these strains
        det = 2 * mean + mean * mean - radius * radius
        s, r = det / (2 + det), radius / (1 + mean)
        volumetric, deviatoric = s * series(s * s), 0.5 * r * series(r * r)
        v, d = returned(p, volumetric, deviatoric)
        inverse = 1 / ti.max(radius, 1e-18)
        direction = ti.Matrix([[half, b[0, 1]], [b[0, 1], -half]]) * inverse
        if v != volumetric or d != deviatoric:
            plus, minus = ti.exp(v + 2 * d), ti.exp(v - 2 * d)
            b = (0.5 * (plus + minus) - 1) * identity + 0.5 * (plus - minus) * direction
        elastic[p] = b
        tau = BULK * v * identity + 2 * SHEAR * d * direction
    else:
        u, sigma, w = ti.svd((identity + affine[p]) @ elastic[p], real)
        first, second = ti.log(sigma[0, 0]), ti.log(sigma[1, 1])
        v, d = returned(p, first + second, 0.5 * (first - second))
        first, second = 0.5 * v + d, 0.5 * v - d
        elastic[p] = u @ ti.Matrix([[ti.exp(first), 0], [0, ti.exp(second)]]) @ w.transpose()
        tau = (
            u
            @ ti.Matrix([[2 * SHEAR * first + LAME * v, 0], [0, 2 * SHEAR * second + LAME * v]])
            @ u.transpose()
        )
    return tau * SCALE


@ti.func
def series(z):
    """atanh(s) / s of z = s * s <= 0.03."""
    sum = ti.cast(0, real)
    for i in ti.static(range(4 if options.precision == "f32" else 10, 0, -1)):
        sum = (sum + 1.0 / (2 * i + 1)) * z
    return 1 + sum


@ti.func
def nodes(x):
    """Lowest node of a particle, its distance from it, and the weights."""
    base = ti.cast(x - 0.5, ti.i32)
    f = x - ti.cast(base, real)
    return base, f, [0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2]


@ti.kernel
def step():
    for i, j in mass:
        momentum[i, j] = ti.Vector.zero(real, 2)
        mass[i, j] = 0
    for p in position:
        tau = stress(p)
        base, f, w = nodes(position[p])
        a = affine[p] - tau
        for i, j in ti.static(ti.ndrange(3, 3)):
            weight = w[i][0] * w[j][1]
            momentum[base + ti.Vector([i, j])] += weight * (velocity[p] + a @ (ti.Vector([i, j]) - f))
            mass[base + ti.Vector([i, j])] += weight
    for i, j in mass:
        if mass[i, j] > 0:
            v = momentum[i, j] / mass[i, j]
            v[1] -= FALL
            if j <= bed_row[i]:
                n = bed_normal[i]
                into = v.dot(n)
                if into < 0:
                    t = ti.Vector([n[1], -n[0]])
                    slide = v.dot(t)
                    v = t * (ti.max(ti.abs(slide) + BED_FRICTION * into, 0) * ti.math.sign(slide))
            momentum[i, j] = v
    for p in position:
        base, f, w = nodes(position[p])
        v, c = ti.Vector.zero(real, 2), ti.Matrix.zero(real, 2, 2)
        for i, j in ti.static(ti.ndrange(3, 3)):
            of_node = w[i][0] * w[j][1] * momentum[base + ti.Vector([i, j])]
            v += of_node
            c += 4 * of_node.outer_product(ti.Vector([i, j]) - f)
        velocity[p], affine[p] = v, c
        position[p] += v


release()
step()
best, total, processor, parts = 0.0, 0.0, 0.0, 10
release()
ti.sync()
for _ in range(parts):
    started, running = time.perf_counter(), time.process_time()
    for _ in range(options.steps // parts):
        step()
    ti.sync()
    taken = time.perf_counter() - started
    total, processor = total + taken, processor + time.process_time() - running
    best = max(best, count * (options.steps // parts) / taken)
done = count * (options.steps // parts) * parts
centre = position.to_numpy().mean(axis=0, dtype=float)
print(
    json.dumps(
        {
            "code": f"taichi {'.'.join(map(str, ti.__version__))}",
            "strains": options.strains,
            "regime": options.regime,
            "mesh_m": MESH,
            "precision": options.precision,
            "threads": 1,
            "particles": count,
            "steps": options.steps // parts * parts,
            "particle_steps_per_s": done / total,
            "best": best,
            "of_processor_time": done / processor,
            "centre_m": [(centre[0] + first_column) * MESH, (centre[1] + first_row) * MESH],
        }
    )
)

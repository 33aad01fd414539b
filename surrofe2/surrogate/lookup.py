"""Stress, status and risk of a surrogate in one compiled pass; slopes in another.

Points are taken in blocks of `TILES` tiles of `TILE` points; every quantity is a row of a block,
(TILES, TILE), and each operation is one of SIMD values of `base.simd`. Slopes by the first K inputs
have the input as first axis, (K, rows, TILES, TILE); where a value alone is wanted, K is 0. Rows of
a layer are computed four at a time, so sizes are padded with zeros to multiples of four. Sums of
SIMD values keep their order, so the bits of a result do not depend on the place of its point.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Index
from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.sampling import SLACK, SamplingRange
from surrofe2.base.simd import (
    TILE,
    any_less,
    fill_tanh,
    inverse_root,
    load,
    root,
    spread,
    store,
    where_less,
)
from surrofe2.base.square_symmetry import DIFFERENCE, SHEAR, SPIN, SUM
from surrofe2.base.tensors import INPUTS
from surrofe2.law.stress_law import Status
from surrofe2.surrogate.domain import (
    ALL_INPUTS,
    COMPRESSION,
    NEAR,
    NORM,
    REACH,
    SQUARES,
    Calibration,
    Domain,
    boundary_products,
    scale_products,
)
from surrofe2.surrogate.features import (
    BEND,
    BENT,
    COMPONENTS,
    NETWORK_INPUTS,
    NetworkParameters,
)
from surrofe2.surrogate.products import (
    BLOCK,
    ONE,
    STRETCH,
    TILES,
    Polynomials,
    Product,
    bare_kernel,
    evaluate,
    make_room,
)

MANY = 2000
"""Points from which on more than one core pays."""
# Points that a core takes at a time.
_PART = 8 * BLOCK
# Kernels compare plain integers.
_OK = int(Status.OK)
_OUT_OF_RANGE = int(Status.OUT_OF_RANGE)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_TRUSTED = int(Status.NOT_TRUSTED)

# Rows of the frame of a block: F, and its rate V = Ḟ; the rotation R, U and A = RᵀḞ, in the order
# of `SamplingRange.ends`; 1 or 0, whether the point is in range; the stress.
_F11, _F12, _F21, _F22 = range(4)
_V11, _V12, _V21, _V22 = range(4, 8)
_COS, _SIN = range(8, 10)
_U11, _U22, _U12, _A11, _A12, _A21, _A22 = range(10, 17)
_INSIDE = 17
_S11, _S12, _S21, _S22 = range(18, 22)
_FRAME_ROWS = 22
# The polynomials of `BoundArrays`: logarithm of the odds of failure, positive beyond the boundary;
# the bound over the tolerance; the square of what the inputs add to the tolerance at rest.
_HEIGHT, _BOUND, _SQUARE = range(3)


class NetworkArrays(NamedTuple):
    """A network as the arrays that its kernels read.

    Attributes:
        input_factor: (7,) by which inputs are multiplied, 1/input scale.
        output_factor: (4,) by which terms of a component are multiplied, µN/µm.
        at_rest: (t,) factors at rest of terms from which they are subtracted, else 0.
        products: `Polynomials.products` of the baseline of P̂, as for the six fields that follow.
        begins: see `Polynomials`.
        heads: see `Polynomials`.
        group_begins: see `Polynomials`.
        rows: see `Polynomials`.
        coefficients: see `Polynomials`.
        kept: rows of the products of the t terms, then those of the invariants.
        components: (t,) int64 component of P̂ to which each term belongs.
        sizes: (layers + 1,) int64 number of inputs, then of outputs of each layer of the network of
            factors, padded to multiples of four.
        weights: weights of all layers, flat, one layer after the other.
        biases: biases of all layers, likewise.
    """

    input_factor: Array
    output_factor: Array
    at_rest: Array
    products: Index
    begins: Index
    heads: Index
    group_begins: Index
    rows: Index
    coefficients: Array
    kept: Index
    components: Index
    sizes: Index
    weights: Array
    biases: Array

    @classmethod
    def of(cls, network: NetworkParameters) -> NetworkArrays:
        """Make the arrays of a network."""
        features = network.features
        matrices = [_padded(matrix) for matrix, _ in network.layers]
        biases = [_padded(bias) for _, bias in network.layers]
        term_products = [product for product, _ in features.terms]
        baseline = Polynomials.of(
            NETWORK_INPUTS, network.baseline, kept=[*term_products, *features.invariants]
        )
        arrays = cls(
            input_factor=1.0 / network.tensors["input_scale"],
            output_factor=network.tensors["output_scale"],
            at_rest=np.zeros(len(term_products)),
            products=baseline.products,
            begins=baseline.begins,
            heads=baseline.heads,
            group_begins=baseline.group_begins,
            rows=baseline.rows,
            coefficients=baseline.coefficients,
            kept=baseline.kept,
            components=np.array([component for _, component in features.terms]),
            sizes=np.array([matrices[0].shape[1], *(len(matrix) for matrix in matrices)]),
            weights=np.concatenate([matrix.ravel() for matrix in matrices]),
            biases=np.concatenate(biases),
        )
        # The factors at rest are computed by the very instructions of the kernels, so that the
        # difference factor − factor at rest is exactly 0 there and not only but for rounding.
        room = make_room(arrays, NETWORK_INPUTS, 0)
        units = _make_units(arrays, 0)
        room.rows[:NETWORK_INPUTS] = 0.0
        room.rows[ONE] = 1.0
        first = _evaluate_factors(arrays, room, units)
        factors = units.values[first : first + len(term_products), 0, 0]
        is_subtracted = np.array([not product for product in term_products])
        return arrays._replace(at_rest=np.where(is_subtracted, factors, 0.0))


def _padded(array: Array) -> Array:
    """Return an array with zeros behind, so that each of its sizes is a multiple of four."""
    return np.pad(array, [(0, -size % 4) for size in array.shape])


class Units(NamedTuple):
    """Room for what the units of all layers give, used again for the next block.

    Attributes:
        values: (units, TILES, TILE).
        flat: the same in one row.
        slopes: (K, units, TILES, TILE) by each of the first K inputs; K = 0: of none.
        zeros: as many as a layer has units.
    """

    values: Any
    flat: Any
    slopes: Any
    zeros: Any


class BoundArrays(NamedTuple):
    """Range, domain and bound as the arrays that their kernel reads.

    The polynomials are those of `_HEIGHT`, `_BOUND` and `_SQUARE`, of the inputs of
    `domain.all_inputs`.

    Attributes:
        limits: (2, 7) lower and upper ends between which U₁₁, U₂₂, U₁₂ and the entries of A are in
            range; they are wider than the range by the rounding of the range test.
        factor: (7,) by which inputs are multiplied, 1/scale.
        near: (7,) share of each squared input in the size of a state.
        products: see `Polynomials`.
        begins: see `Polynomials`.
        heads: see `Polynomials`.
        group_begins: see `Polynomials`.
        rows: see `Polynomials`.
        coefficients: see `Polynomials`.
        at_rest: error allowed at rest, as a fraction of the tolerance.
    """

    limits: Array
    factor: Array
    near: Array
    products: Index
    begins: Index
    heads: Index
    group_begins: Index
    rows: Index
    coefficients: Array
    at_rest: float

    @classmethod
    def of(
        cls,
        range: SamplingRange,
        domain: Domain | None,
        calibration: Calibration | None,
        tolerance: Array | None,
    ) -> BoundArrays:
        """Make the arrays of a range, a domain and a bound.

        Args:
            range: bounds of U and A.
            domain: part of the range in which samples did not fail; None: all of it.
            calibration: bound of the error; None: it is infinite.
            tolerance: (9,) of a `SurrogateLaw`; None: 1 µN/µm everywhere. Where the last entry is
                infinite, the risk is 0, whatever the bound.
        """
        if tolerance is None:
            tolerance = np.array([*[0.0] * INPUTS, 1.0, 1.0])
        *squares, at_rest, most = tolerance
        lower, upper = range.ends
        slack = SLACK * np.array([1.0, 1.0, 1.0, *[range.rate] * 4])
        # the range test is ≤, the kernel's comparison <
        with np.errstate(under="ignore"):  # the number next to 0 counts as an underflow
            limits = np.nextafter([lower - slack, upper + slack], [[-np.inf], [np.inf]])

        factor = np.ones(INPUTS)
        near = np.ones(INPUTS)
        boundary: list[tuple[Product, float]] = []
        bound: list[tuple[Product, float]] = [((), np.inf)]
        if domain is not None:
            factor = 1.0 / domain.scale
            if len(domain.boundary):
                products = boundary_products(domain.square)
                boundary = list(zip(products, domain.boundary, strict=True))
            if calibration is not None and np.isfinite(calibration.quantile):
                scale = calibration.quantile * calibration.scale / most
                # coefficients that are 0 are left out, which saves most of the products
                bound = [
                    (product, value)
                    for product, value in zip(scale_products(), scale, strict=True)
                    if value > 0.0
                ]
                near = calibration.near
        if np.isinf(most):
            bound = []
        added = [((SQUARES + k,), value) for k, value in enumerate(squares) if value]
        polynomials = Polynomials.of(ALL_INPUTS, [boundary, bound, added])
        return cls(
            limits=limits,
            factor=factor,
            near=near,
            products=polynomials.products,
            begins=polynomials.begins,
            heads=polynomials.heads,
            group_begins=polynomials.group_begins,
            rows=polynomials.rows,
            coefficients=polynomials.coefficients,
            at_rest=float(at_rest),
        )


def lookup(
    F: Array,
    F_dot: Array,
    network: NetworkArrays,
    bounds: BoundArrays,
    limit: float,
    *,
    with_stress: bool = True,
) -> tuple[Array, NDArray[np.int8], Array]:
    """Compute stress (n, 2, 2) in µN/µm, NaN where the status (n,) is not 0, and risk (n,).

    Points with NaN or det F ≤ 0 are out of range.

    Args:
        F: (n, 2, 2) contiguous float64.
        F_dot: (n, 2, 2) contiguous float64, 1/µs.
        limit: largest risk at which a stress is trusted.
        with_stress: False leaves the stress out (None); the status then does not tell whether it
            is finite.
    """
    count = len(F)
    stress: Any = None
    evaluated: NetworkArrays | None = None
    if with_stress:
        stress = np.empty(F.shape)
        evaluated = network
    status = np.empty(count, dtype=np.int8)
    risk = np.empty(count)
    compute = _lookup_parallel if count >= MANY else _lookup_part
    compute(0, count, F, F_dot, evaluated, bounds, float(limit), stress, status, risk)
    return stress, status, risk


def evaluate_slopes(F: Array, F_dot: Array, network: NetworkArrays) -> tuple[Array, Array]:
    """Compute the components of P̂ (n, 4) and their slopes by the inputs (n, 4, 7), µN/µm.

    No range is tested. F, F_dot: (n, 2, 2) contiguous float64, det F > 0.
    """
    P = np.empty((len(F), COMPONENTS))
    P_slopes = np.empty((len(F), COMPONENTS, INPUTS))
    _slopes(F, F_dot, network, P, P_slopes)
    return P, P_slopes


@parallel_kernel
def _lookup_parallel(  # type: ignore[no-untyped-def]
    begin, end, F, F_dot, network, bounds, limit, stress, status, risk
):
    """Do as `_lookup_part`, with parts of `_PART` points shared out among the cores."""
    for part in prange((end - begin + _PART - 1) // _PART):
        first = begin + part * _PART
        last = min(first + _PART, end)
        _lookup_part(first, last, F, F_dot, network, bounds, limit, stress, status, risk)


@kernel
def _lookup_part(  # type: ignore[no-untyped-def]
    begin, end, F, F_dot, network, bounds, limit, stress, status, risk
):
    """Fill status (n,) and risk (n,) at points `begin` to `end` by range, boundary and bound.

    With a network it fills stress (n, 2, 2), too; network and stress may be None.

    F, F_dot: (n, 2, 2). limit: largest risk at which a stress is trusted.
    """
    frame = np.empty((_FRAME_ROWS, TILES, TILE))
    trust = make_room(bounds, ALL_INPUTS, 0)
    of_network = None
    if network is not None:
        of_network = make_room(network, NETWORK_INPUTS, 0), _make_units(network, 0)
    rooms = frame, trust, of_network
    _lookup_blocks(begin, end, F, F_dot, network, bounds, limit, rooms, stress, status, risk)


@bare_kernel
def _lookup_blocks(  # type: ignore[no-untyped-def]
    begin, end, F, F_dot, network, bounds, limit, rooms, stress, status, risk
):
    """Do the work of `_lookup_part`, block by block, in the arrays `rooms` that it made.

    They are the frame; the room of the polynomials of `BoundArrays`; and room and units of the
    network, or None.
    """
    frame, trust, of_network = rooms
    for start in range(begin, end, BLOCK):
        _read_points(start, F, F_dot, frame)
        _take_rotation_out(frame)
        _set_inside(frame, bounds.limits)
        _scale_inputs(frame, bounds.factor, trust.rows)
        _set_even_inputs(bounds.near, trust.rows)
        evaluate(bounds, trust)
        _divide_by_local_tolerance(bounds.at_rest, trust.y)
        if network is not None:
            room, units = of_network
            _set_inputs(frame, network, room)
            _evaluate_network(network, room, units)
            _set_stress(room.y, frame)
        for t in range(TILES):
            first = start + t * TILE
            count = np.uint64(max(0, min(TILE, end - first)))  # the last block may be part empty
            is_plain = _is_plain(frame, trust.y, limit, stress is not None, t)
            for lane in range(count):
                point = np.uint64(first) + lane
                risk[point] = trust.y[_BOUND, t, lane]
                status[point] = _OK
                if stress is not None:
                    stress[point, 0, 0] = frame[_S11, t, lane]
                    stress[point, 0, 1] = frame[_S12, t, lane]
                    stress[point, 1, 0] = frame[_S21, t, lane]
                    stress[point, 1, 1] = frame[_S22, t, lane]
                if not is_plain:
                    value, code = _judged(frame, trust.y, limit, stress is not None, t, lane)
                    risk[point] = value
                    status[point] = code
                    if stress is not None and code != _OK:
                        stress[point] = np.nan


@bare_kernel
def _is_plain(frame, y, limit, has_stress, t):  # type: ignore[no-untyped-def]
    """Return whether the status is OK at all points of tile t, so that none needs `_judged`.

    frame: rows of the block. y: polynomials of `BoundArrays`. has_stress: whether it is tested.
    """
    plain = where_less(0.0, load(y, _HEIGHT, t), 0.0, load(frame, _INSIDE, t))
    plain = where_less(load(y, _BOUND, t), limit, plain, 0.0)
    if has_stress:
        for i in range(4):
            value = load(frame, _S11 + i, t)
            plain = where_less(value, np.inf, plain, 0.0)
            plain = where_less(-np.inf, value, plain, 0.0)
    return not any_less(plain, 1.0)


@bare_kernel
def _judged(frame, y, limit, has_stress, t, lane):  # type: ignore[no-untyped-def]
    """Return risk and status of one point; arguments as of `_is_plain`.

    Of several faults a stress that is not finite counts first, then the range, then the risk.
    """
    value = y[_BOUND, t, lane]
    inside = frame[_INSIDE, t, lane] > 0.0
    if has_stress and inside:
        for i in range(4):
            if not np.isfinite(frame[_S11 + i, t, lane]):
                return np.inf, _NOT_FINITE
    if not (inside and y[_HEIGHT, t, lane] <= 0.0):
        return np.inf, _OUT_OF_RANGE
    if not value <= limit:  # True for NaN, too
        return value, _NOT_TRUSTED
    return value, _OK


@kernel
def _slopes(F, F_dot, network, P, slopes):  # type: ignore[no-untyped-def]
    """Fill P (n, 4) with the components of P̂ and slopes (n, 4, 7) with theirs by the inputs."""
    frame = np.empty((_FRAME_ROWS, TILES, TILE))
    room = make_room(network, NETWORK_INPUTS, INPUTS)
    units = _make_units(network, INPUTS)
    for start in range(0, F.shape[0], BLOCK):
        _read_points(start, F, F_dot, frame)
        _take_rotation_out(frame)
        _set_inputs(frame, network, room)
        _evaluate_network(network, room, units)
        for p in range(min(BLOCK, F.shape[0] - start)):
            t = p // TILE
            lane = p % TILE
            for component in range(COMPONENTS):
                P[start + p, component] = room.y[component, t, lane]
                for k in range(INPUTS):
                    # by the input, where `room` has the slope by the scaled input
                    slope = room.y_slopes[k, component, t, lane] * network.input_factor[k]
                    slopes[start + p, component, k] = slope


@bare_kernel
def _read_points(start, F, F_dot, frame):  # type: ignore[no-untyped-def]
    """Set the rows of F and Ḟ of the frame by the points from `start` on.

    F, F_dot: (n, 2, 2). The last point fills the rest of the last block.
    """
    for p in range(BLOCK):
        point = min(start + p, F.shape[0] - 1)
        t = p // TILE
        lane = p % TILE
        for i in range(4):
            frame[_F11 + i, t, lane] = F[point, i // 2, i % 2]
            frame[_V11 + i, t, lane] = F_dot[point, i // 2, i % 2]


@bare_kernel
def _take_rotation_out(frame):  # type: ignore[no-untyped-def]
    """Set the rows of R, U = RᵀF and A = RᵀḞ from those of F and Ḟ.

    The polar rotation of a 2 × 2 tensor has cos ∝ F₁₁ + F₂₂ and sin ∝ F₂₁ − F₁₂.
    """
    for t in range(TILES):
        xx = load(frame, _F11, t)
        xy = load(frame, _F12, t)
        yx = load(frame, _F21, t)
        yy = load(frame, _F22, t)
        along = xx + yy
        across = yx - xy
        per_length = 1.0 / root(along * along + across * across)
        c = along * per_length
        s = across * per_length
        store(c, frame, _COS, t)
        store(s, frame, _SIN, t)
        store(c * xx + s * yx, frame, _U11, t)
        store(c * xy + s * yy, frame, _U12, t)
        store(c * yy - s * xy, frame, _U22, t)
        xx = load(frame, _V11, t)
        xy = load(frame, _V12, t)
        yx = load(frame, _V21, t)
        yy = load(frame, _V22, t)
        store(c * xx + s * yx, frame, _A11, t)
        store(c * xy + s * yy, frame, _A12, t)
        store(c * yx - s * xx, frame, _A21, t)
        store(c * yy - s * xy, frame, _A22, t)


@bare_kernel
def _set_inside(frame, limits):  # type: ignore[no-untyped-def]
    """Set `_INSIDE` to 1 where U₁₁, U₂₂, U₁₂ and all of A are between limits (2, 7), else to 0."""
    for t in range(TILES):
        inside = spread(1.0)
        for k in range(INPUTS):
            value = load(frame, _U11 + k, t)
            inside = where_less(value, limits[1, k], inside, 0.0)
            inside = where_less(limits[0, k], value, inside, 0.0)
        store(inside, frame, _INSIDE, t)


@bare_kernel
def _scale_inputs(frame, factor, x):  # type: ignore[no-untyped-def]
    """Set the scaled inputs of `tensors` and the input that is 1, rows of x (·, TILES, TILE).

    Inputs of U − I come first, those of A follow from STRETCH on.

    factor: (7,) by which inputs are multiplied.
    """
    for t in range(TILES):
        u11 = load(frame, _U11, t)
        u22 = load(frame, _U22, t)
        a11 = load(frame, _A11, t)
        a12 = load(frame, _A12, t)
        a21 = load(frame, _A21, t)
        a22 = load(frame, _A22, t)
        # 1 is subtracted first, which near rest rounds less
        store(((u11 - 1.0) + (u22 - 1.0)) * factor[SUM], x, SUM, t)
        store((u11 - u22) * factor[DIFFERENCE], x, DIFFERENCE, t)
        store(load(frame, _U12, t) * (2.0 * factor[SHEAR]), x, SHEAR, t)
        store((a11 + a22) * factor[STRETCH + SUM], x, STRETCH + SUM, t)
        store((a11 - a22) * factor[STRETCH + DIFFERENCE], x, STRETCH + DIFFERENCE, t)
        store((a12 + a21) * factor[STRETCH + SHEAR], x, STRETCH + SHEAR, t)
        store((a21 - a12) * factor[STRETCH + SPIN], x, STRETCH + SPIN, t)
        store(1.0, x, ONE, t)


@bare_kernel
def _set_inputs(frame, network, room):  # type: ignore[no-untyped-def]
    """Set the inputs of a network, see `features`: x, 1, and u = x/√(δ² + x²) of U − I.

    With slopes, du/dx = δ²/(δ² + x²)^(3/2) is set, too; δ is BEND.
    """
    x = room.rows
    slopes = room.slopes
    _scale_inputs(frame, network.input_factor, x)
    for k in range(STRETCH):
        for t in range(TILES):
            value = load(x, k, t)
            inverse = inverse_root(value * value + BEND * BEND)
            store(value * inverse, x, BENT + k, t)
            if slopes.shape[0]:
                store(BEND * BEND * inverse * inverse * inverse, slopes, k, BENT + k, t)


@bare_kernel
def _evaluate_network(arrays, room, units):  # type: ignore[no-untyped-def]
    """Set room.y to the components of P̂, and room.y_slopes to theirs by scaled inputs.

    Each component is its baseline plus, for each of its terms, (factor − factor at rest) × product.
    """
    first = _evaluate_factors(arrays, room, units)
    y = room.y
    y_slopes = room.y_slopes
    for term in range(arrays.components.shape[0]):
        component = arrays.components[term]
        row = arrays.kept[term]
        scale = arrays.output_factor[component]
        at_rest = arrays.at_rest[term]
        for t in range(TILES):
            factor = (load(units.values, first + term, t) - at_rest) * scale
            product = load(room.rows, row, t)
            store(load(y, component, t) + factor * product, y, component, t)
            for k in range(y_slopes.shape[0]):
                slope = load(units.slopes, k, first + term, t) * (product * scale)
                slope += factor * load(room.slopes, k, row, t)
                store(load(y_slopes, k, component, t) + slope, y_slopes, k, component, t)


@kernel
def _make_units(arrays, along):  # type: ignore[no-untyped-def]
    """Make `Units` for all layers, with slopes by the first `along` inputs."""
    count = arrays.sizes.sum()
    flat = np.empty(count * BLOCK)
    slopes = np.empty((along, count, TILES, TILE))
    return Units(flat.reshape(count, TILES, TILE), flat, slopes, np.zeros(arrays.sizes.max()))


@bare_kernel
def _evaluate_factors(arrays, room, units):  # type: ignore[no-untyped-def]
    """Set room.y to the baseline and compute all units; return the row of the first factor.

    If there is room for slopes, they are computed, too.
    """
    kept = arrays.kept
    values = units.values
    slopes = units.slopes
    evaluate(arrays, room)
    terms = arrays.components.shape[0]
    invariants = kept.shape[0] - terms
    # the first layer of units is the invariants, and zeros that make a multiple of four of them
    for k in range(arrays.sizes[0]):
        is_invariant = k < invariants
        for t in range(TILES):
            if is_invariant:
                store(load(room.rows, kept[terms + k], t), values, k, t)
            else:
                store(0.0, values, k, t)
            for along in range(slopes.shape[0]):
                if is_invariant:
                    store(load(room.slopes, along, kept[terms + k], t), slopes, along, k, t)
                else:
                    store(0.0, slopes, along, k, t)
    return _forward(arrays, units)


@bare_kernel
def _forward(arrays, units):  # type: ignore[no-untyped-def]
    """Compute the units of all layers, and their slopes, from those of the first.

    h ← tanh(W h + b) and h′ ← (1 − h²) W h′; the last layer has no tanh. Return its first row.
    """
    sizes = arrays.sizes
    weights = arrays.weights
    biases = arrays.biases
    values = units.values
    slopes = units.slopes
    begin = 0
    first_weight = 0
    first_bias = 0
    for layer in range(1, sizes.shape[0]):
        rows = sizes[layer]
        columns = sizes[layer - 1]
        end = first_weight + rows * columns
        matrix = weights[first_weight:end]
        middle = begin + columns
        is_last = layer == sizes.shape[0] - 1
        bias = biases[first_bias : first_bias + rows]
        _apply_layer(matrix, bias, values[begin:middle], values[middle:])
        if not is_last:
            fill_tanh(units.flat[middle * BLOCK : (middle + rows) * BLOCK])
        for k in range(slopes.shape[0]):
            _apply_layer(matrix, units.zeros[:rows], slopes[k, begin:middle], slopes[k, middle:])
            if not is_last:
                _times_tanh_slope(values[middle:], slopes[k, middle:], rows)
        begin = middle
        first_weight = end
        first_bias += rows
    return begin


@bare_kernel
def _times_tanh_slope(tanh, slopes, rows):  # type: ignore[no-untyped-def]
    """Multiply slopes (rows, …) by 1 − tanh²."""
    for row in range(rows):
        for t in range(TILES):
            h = load(tanh, row, t)
            store((1.0 - h * h) * load(slopes, row, t), slopes, row, t)


@bare_kernel
def _apply_layer(matrix, bias, source, target):  # type: ignore[no-untyped-def]
    """Set target (rows, TILES, TILE) to matrix · source (columns, TILES, TILE) + bias (rows,).

    matrix: (rows · columns,), row after row. Sums of four rows and two tiles, a to h, stay in
    registers.
    """
    columns = source.shape[0]
    for t in range(0, TILES, 2):
        for j in range(0, bias.shape[0], 4):
            one_row = np.uint64(j * columns)
            next_row = np.uint64((j + 1) * columns)
            third_row = np.uint64((j + 2) * columns)
            last_row = np.uint64((j + 3) * columns)
            a = spread(bias[j])
            b = spread(bias[j + 1])
            c = spread(bias[j + 2])
            d = spread(bias[j + 3])
            e = a
            f = b
            g = c
            h = d
            for k in range(np.uint64(columns)):
                one = load(source, k, t)
                two = load(source, k, t + 1)
                first = spread(matrix[one_row + k])
                second = spread(matrix[next_row + k])
                third = spread(matrix[third_row + k])
                fourth = spread(matrix[last_row + k])
                a += first * one
                b += second * one
                c += third * one
                d += fourth * one
                e += first * two
                f += second * two
                g += third * two
                h += fourth * two
            store(a, target, j, t)
            store(b, target, j + 1, t)
            store(c, target, j + 2, t)
            store(d, target, j + 3, t)
            store(e, target, j, t + 1)
            store(f, target, j + 1, t + 1)
            store(g, target, j + 2, t + 1)
            store(h, target, j + 3, t + 1)


@bare_kernel
def _set_stress(y, frame):  # type: ignore[no-untyped-def]
    """Set the rows of σ in the frame from the components of P̂, the rows of y.

    S = P̂ U/det U, and σ = R S Rᵀ: R turns difference and shear of S by twice its own angle, and
    leaves its sum and spin. Components are halved here: S₁₁ is half of the sum plus half of the
    difference. With n, d and g the sum, difference and shear of U, 4 det U = n² − d² − g².
    """
    for t in range(TILES):
        u11 = load(frame, _U11, t)
        u22 = load(frame, _U22, t)
        n = u11 + u22
        d = u11 - u22
        g = 2.0 * load(frame, _U12, t)
        total = load(y, SUM, t)
        difference = load(y, DIFFERENCE, t)
        shear = load(y, SHEAR, t)
        spin = load(y, SPIN, t)
        factor = 1.0 / (n * n - d * d - g * g)
        S_sum = factor * (n * total + d * difference + g * shear)
        S_difference = factor * (d * total + n * difference - g * spin)
        S_shear = factor * (g * total + n * shear + d * spin)
        S_spin = factor * (n * spin - g * difference + d * shear)
        cos = load(frame, _COS, t)
        sin = load(frame, _SIN, t)
        cos_twice = cos * cos - sin * sin
        sin_twice = 2.0 * cos * sin
        turned_difference = cos_twice * S_difference - sin_twice * S_shear
        turned_shear = sin_twice * S_difference + cos_twice * S_shear
        store(S_sum + turned_difference, frame, _S11, t)
        store(turned_shear - S_spin, frame, _S12, t)
        store(turned_shear + S_spin, frame, _S21, t)
        store(S_sum - turned_difference, frame, _S22, t)


@bare_kernel
def _set_even_inputs(near, x):  # type: ignore[no-untyped-def]
    """Set the rows of `domain.all_inputs` that follow the inputs and 1, in x (·, TILES, TILE).

    near: (7,) share of each squared input in the size of a state.
    """
    for t in range(TILES):
        compression = where_less(load(x, SUM, t), 0.0, load(x, SUM, t), 0.0)
        store(compression * compression, x, COMPRESSION, t)
        total = spread(0.0)
        size = spread(0.0)
        for k in range(INPUTS):
            square = load(x, k, t) * load(x, k, t)
            store(square, x, SQUARES + k, t)
            total += square
            size += near[k] * square
        store(total * (1.0 / INPUTS), x, NORM, t)
        store(size / (size + REACH), x, NEAR, t)


@bare_kernel
def _divide_by_local_tolerance(at_rest, y):  # type: ignore[no-untyped-def]
    """Turn the bound in y into the risk: divide it by `SurrogateLaw.local_tolerance`.

    at_rest: error allowed at rest, as a fraction of the tolerance.
    """
    for t in range(TILES):
        allowed = root(load(y, _SQUARE, t)) + at_rest
        allowed = where_less(allowed, 1.0, allowed, 1.0)  # at most 1
        store(load(y, _BOUND, t) / allowed, y, _BOUND, t)

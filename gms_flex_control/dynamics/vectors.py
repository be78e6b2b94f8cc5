# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Vectors in space for the kernels: tuples, which a compiler keeps in registers.

A vector is three floats; a rotation its three columns; a symmetric matrix the six floats xx, xy,
xz, yy, yz, zz. A series is a vector's Taylor coefficients in time of order 0, 1 and 2, three
vectors: products of series give time derivatives without a difference quotient. Last come small
matrices of any size, as arrays.
"""

from gms_flex_control.compiled import compiled, compiled_part

Vector = Columns = Series = Symmetric = tuple


@compiled
def vector(values) -> Vector:
    """Return an array (3,) as a vector."""
    return values[0], values[1], values[2]


@compiled
def store(out, v) -> None:
    """Write a vector into an array (3,)."""
    out[0], out[1], out[2] = v[0], v[1], v[2]


@compiled
def add(a, b) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def subtract(a, b) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def scale(factor, a) -> Vector:
    """Return a vector times a number."""
    return factor * a[0], factor * a[1], factor * a[2]


@compiled
def dot(a, b) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a, b) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled_part
def combine(columns, v) -> Vector:
    """Return a matrix, given by its columns, times a vector."""
    x, y, z = columns
    return (x[0] * v[0] + y[0] * v[1] + z[0] * v[2], x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
            x[2] * v[0] + y[2] * v[1] + z[2] * v[2])


@compiled_part
def project(columns, v) -> Vector:
    """Return the transpose of a matrix, given by its columns, times a vector."""
    return dot(columns[0], v), dot(columns[1], v), dot(columns[2], v)


@compiled
def rotation(values) -> Columns:
    """Return an array (3, 3) as columns."""
    return ((values[0, 0], values[1, 0], values[2, 0]), (values[0, 1], values[1, 1], values[2, 1]),
            (values[0, 2], values[1, 2], values[2, 2]))


@compiled_part
def symmetric(values) -> Symmetric:
    """Return an array (6,) as a symmetric matrix."""
    return values[0], values[1], values[2], values[3], values[4], values[5]


@compiled_part
def symmetric_times(s, v) -> Vector:
    """Return a symmetric matrix times a vector."""
    return (s[0] * v[0] + s[1] * v[1] + s[2] * v[2], s[1] * v[0] + s[3] * v[1] + s[4] * v[2],
            s[2] * v[0] + s[4] * v[1] + s[5] * v[2])


@compiled_part
def rotated(s, columns) -> Symmetric:
    """Return R S R' of a symmetric matrix S and the columns of R."""
    x, y, z = columns
    a = add(scale(s[0], x), add(scale(s[1], y), scale(s[2], z)))
    b = add(scale(s[1], x), add(scale(s[3], y), scale(s[4], z)))
    c = add(scale(s[2], x), add(scale(s[4], y), scale(s[5], z)))
    return (a[0] * x[0] + b[0] * y[0] + c[0] * z[0], a[0] * x[1] + b[0] * y[1] + c[0] * z[1],
            a[0] * x[2] + b[0] * y[2] + c[0] * z[2], a[1] * x[1] + b[1] * y[1] + c[1] * z[1],
            a[1] * x[2] + b[1] * y[2] + c[1] * z[2], a[2] * x[2] + b[2] * y[2] + c[2] * z[2])


@compiled_part
def store_series(out, s) -> None:
    """Write a series into an array (3, 3), one row per order."""
    for k in range(3):
        store(out[k], s[k])


@compiled_part
def load_series(values) -> Series:
    """Return an array (3, 3) as a series."""
    return vector(values[0]), vector(values[1]), vector(values[2])


@compiled_part
def add_series(a, b) -> Series:
    """Return a + b."""
    return add(a[0], b[0]), add(a[1], b[1]), add(a[2], b[2])


@compiled_part
def cross_series(a, b) -> Series:
    """Return the vector product of two series."""
    return (cross(a[0], b[0]), add(cross(a[1], b[0]), cross(a[0], b[1])),
            add(add(cross(a[2], b[0]), cross(a[1], b[1])), cross(a[0], b[2])))


@compiled_part
def constant_cross(a, b) -> Series:
    """Return the vector product of a constant vector and a series."""
    return cross(a, b[0]), cross(a, b[1]), cross(a, b[2])


@compiled_part
def scale_series(factor, a) -> Series:
    """Return a number times a series."""
    return scale(factor, a[0]), scale(factor, a[1]), scale(factor, a[2])


@compiled_part
def symmetric_times_series(s, a) -> Series:
    """Return a constant symmetric matrix times a series."""
    return symmetric_times(s, a[0]), symmetric_times(s, a[1]), symmetric_times(s, a[2])


@compiled
def product(a, b) -> Vector:
    """Return the product of two series of numbers."""
    return a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + a[1] * b[1] + a[0] * b[2]


@compiled
def turned(c, s, a) -> Series:
    """Return a series of vectors turned about z by the angle of cosine and sine, series too."""
    cx = product(c, (a[0][0], a[1][0], a[2][0]))
    cy = product(c, (a[0][1], a[1][1], a[2][1]))
    sx = product(s, (a[0][0], a[1][0], a[2][0]))
    sy = product(s, (a[0][1], a[1][1], a[2][1]))
    return ((cx[0] - sy[0], sx[0] + cy[0], a[0][2]), (cx[1] - sy[1], sx[1] + cy[1], a[1][2]),
            (cx[2] - sy[2], sx[2] + cy[2], a[2][2]))


@compiled_part
def turned_back(c, s, a) -> Series:
    """Return a series of vectors turned about z by minus the angle of cosine and sine."""
    return turned(c, (-s[0], -s[1], -s[2]), a)


@compiled
def multiply(matrix, vector, out) -> None:
    """Write ``matrix`` (n, n) times ``vector`` (n,) into ``out`` (n,)."""
    n = matrix.shape[0]
    for i in range(n):
        total = 0.0  # a local sum: the compiler cannot keep out[i] in a register
        for j in range(n):
            total += matrix[i, j] * vector[j]
        out[i] = total


@compiled_part
def multiply_transposed(matrix, vector, out) -> None:
    """Write the transpose of ``matrix`` (n, n) times ``vector`` (n,) into ``out`` (n,)."""
    n = matrix.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += matrix[j, i] * vector[j]
        out[i] = total


@compiled_part
def factorise(matrix) -> None:
    """Factorise a symmetric positive definite matrix (n, n) in its upper triangle, in place."""
    n = matrix.shape[0]
    for i in range(n):
        reciprocal = 1.0 / matrix[i, i]
        for k in range(i + 1, n):
            factor = matrix[i, k] * reciprocal
            for j in range(k, n):
                matrix[k, j] -= factor * matrix[i, j]
        matrix[i, i] = reciprocal


@compiled_part
def solve_factorised(matrix, vector) -> None:
    """Solve for ``vector`` (n,) in place, the matrix of `factorise`."""
    n = matrix.shape[0]
    for i in range(n):
        for k in range(i + 1, n):
            vector[k] -= matrix[i, k] * matrix[i, i] * vector[i]
    for i in range(n - 1, -1, -1):
        total = vector[i]
        for j in range(i + 1, n):
            total -= matrix[i, j] * vector[j]
        vector[i] = total * matrix[i, i]

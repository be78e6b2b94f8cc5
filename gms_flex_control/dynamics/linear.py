# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Small symmetric systems of fixed size, in place."""

from gms_flex_control.compiled import compiled


@compiled
def multiply(matrix, vector, out):
    """Write ``matrix`` (n, n) times ``vector`` (n,) into ``out`` (n,)."""
    n = matrix.shape[0]
    for i in range(n):
        total = 0.0  # a local sum: the compiler cannot keep out[i] in a register
        for j in range(n):
            total += matrix[i, j] * vector[j]
        out[i] = total


@compiled
def multiply_transposed(matrix, vector, out):
    """Write the transpose of ``matrix`` (n, n) times ``vector`` (n,) into ``out`` (n,)."""
    n = matrix.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += matrix[j, i] * vector[j]
        out[i] = total


@compiled
def factorise(matrix):
    """Factorise a symmetric positive definite matrix (n, n) in its upper triangle, in place."""
    n = matrix.shape[0]
    for i in range(n):
        reciprocal = 1.0 / matrix[i, i]
        for k in range(i + 1, n):
            factor = matrix[i, k] * reciprocal
            for j in range(k, n):
                matrix[k, j] -= factor * matrix[i, j]
        matrix[i, i] = reciprocal


@compiled
def solve_factorised(matrix, vector):
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

"""Products of small matrices in loops, which compile faster than numba's own and run faster than BLAS."""

from processing.arrays import Matrix, Vector
from processing.kernel import kernel


@kernel
def copy(source: Matrix, target: Matrix) -> None:
    """Make `target` equal to `source`, of the same shape."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@kernel
def add(first: Matrix, second: Matrix, total: Matrix) -> None:
    """Write the sum of two matrices of the same shape into `total`."""
    for i in range(first.shape[0]):
        for j in range(first.shape[1]):
            total[i, j] = first[i, j] + second[i, j]


@kernel
def dot(first: Vector, second: Vector) -> float:
    """Scalar product."""
    total = 0.0
    for i in range(len(first)):
        total += first[i] * second[i]
    return total


@kernel
def times(matrix: Matrix, vector: Vector, product: Vector) -> None:
    """Write the product of a matrix and a vector into `product`."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        product[i] = total


@kernel
def quadratic(matrix: Matrix, vector: Vector) -> float:
    """The quadratic form v^T M v."""
    total = 0.0
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            total += vector[i] * matrix[i, j] * vector[j]
    return total


@kernel
def times_matrix(first: Matrix, second: Matrix, transposed: bool, product: Matrix) -> None:
    """Write the product of two square matrices, or of the first one's transpose, into `product`."""
    n = len(first)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += (first[k, i] if transposed else first[i, k]) * second[k, j]
            product[i, j] = total


@kernel
def sort(values: Vector, count: int) -> None:
    """Sort the first `count` values, ascending (Shell 1959)."""
    gap = count // 2
    while gap > 0:
        for i in range(gap, count):
            value, index = values[i], i
            while index >= gap and values[index - gap] > value:
                values[index] = values[index - gap]
                index -= gap
            values[index] = value
        gap //= 2

"""Vectors and rotations as tuples. Pure.

Rotations are matrices: with the quaternions of geometry/kinematics.py a walker's tick would take four times as long.
"""

import math

from gateway.geometry.kinematics import Quaternion, Vector, about, rotated

Matrix = tuple[Vector, Vector, Vector]
"""A rotation, by rows."""


def scaled(vector: Vector, factor: float) -> Vector:
    """`vector` times `factor`."""
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def minus(first: Vector, second: Vector) -> Vector:
    """The difference of two vectors."""
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


def dot(first: Vector, second: Vector) -> float:
    """The scalar product of two vectors."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def cross(first: Vector, second: Vector) -> Vector:
    """The vector product of two vectors."""
    return (
        first[1] * second[2] - first[2] * second[1],
        first[2] * second[0] - first[0] * second[2],
        first[0] * second[1] - first[1] * second[0],
    )


def apply(matrix: Matrix, vector: Vector) -> Vector:
    """Apply a rotation matrix to `vector`."""
    return dot(matrix[0], vector), dot(matrix[1], vector), dot(matrix[2], vector)


def back(matrix: Matrix, vector: Vector) -> Vector:
    """`vector` before the rotation: apply its inverse, the transpose."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    x, y, z = vector
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def product(first: Matrix, second: Matrix) -> Matrix:
    """The matrix product: `second` in the frame that `first` has rotated."""
    (a, b, c), (d, e, f), (g, h, i) = second
    rows = [(x * a + y * d + z * g, x * b + y * e + z * h, x * c + y * f + z * i) for x, y, z in first]
    return rows[0], rows[1], rows[2]


def matrix(rotation: Quaternion) -> Matrix:
    """The rotation of a unit quaternion."""
    x, y, z = (rotated(rotation, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    return (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])


def turned(axis: Vector, angle: float) -> Matrix:
    """The rotation by an angle about an axis of length 1."""
    if axis == (0.0, 0.0, 1.0):
        cosine, sine = math.cos(angle), math.sin(angle)
        return (cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0)
    return matrix(about(axis, angle))


def perpendicular(axis: Vector) -> Vector:
    """A unit vector perpendicular to `axis`."""
    other = (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0)
    found = minus(other, scaled(axis, dot(other, axis)))
    return scaled(found, 1 / math.sqrt(dot(found, found)))


def angle_about(axis: Vector, begin: Vector, end: Vector) -> float:
    """The angle in radians by which `begin` turns about `axis` to `end`; both are perpendicular to it."""
    return math.atan2(dot(axis, cross(begin, end)), dot(begin, end))


def wrapped(angle: float) -> float:
    """The same angle between -pi and pi."""
    return math.remainder(angle, 2 * math.pi)

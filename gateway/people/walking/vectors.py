"""Vectors and rotations as tuples. Pure.

Rotations are matrices: with the quaternions of geometry/kinematics.py an engine's step would take four times as long.
"""

import math

from gateway.geometry.kinematics import Quaternion, Vector, about, rotated

Matrix = tuple[Vector, Vector, Vector]
"""A rotation, by rows."""


def scaled(vector: Vector, factor: float) -> Vector:
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def minus(first: Vector, second: Vector) -> Vector:
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


def dot(first: Vector, second: Vector) -> float:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def cross(first: Vector, second: Vector) -> Vector:
    return (
        first[1] * second[2] - first[2] * second[1],
        first[2] * second[0] - first[0] * second[2],
        first[0] * second[1] - first[1] * second[0],
    )


def apply(matrix: Matrix, vector: Vector) -> Vector:
    (a, b, c), (d, e, f), (g, h, i) = matrix
    x, y, z = vector
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def back(matrix: Matrix, vector: Vector) -> Vector:
    """`vector` before the rotation: apply its inverse, the transpose."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    x, y, z = vector
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def product(first: Matrix, second: Matrix) -> Matrix:
    """The matrix product: `second` in the frame that `first` has rotated."""
    (a, b, c), (d, e, f), (g, h, i) = second
    (r, s, t), (u, v, w), (x, y, z) = first
    return (
        (r * a + s * d + t * g, r * b + s * e + t * h, r * c + s * f + t * i),
        (u * a + v * d + w * g, u * b + v * e + w * h, u * c + v * f + w * i),
        (x * a + y * d + z * g, x * b + y * e + z * h, x * c + y * f + z * i),
    )


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


def spun(first: Matrix, axis: Vector, angle: float) -> Matrix:
    """`first`, followed by a rotation by an angle about an axis of its frame: most joints turn about z."""
    if axis != (0.0, 0.0, 1.0):
        return product(first, turned(axis, angle))
    cosine, sine = math.cos(angle), math.sin(angle)
    (a, b, c), (d, e, f), (g, h, i) = first
    return (
        (a * cosine + b * sine, b * cosine - a * sine, c),
        (d * cosine + e * sine, e * cosine - d * sine, f),
        (g * cosine + h * sine, h * cosine - g * sine, i),
    )


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

"""Between a run's frame and MAVLink's.

A run: x to the east, y to the north, headings anticlockwise from east. MAVLink: north, east, down, yaw clockwise from north.
"""

from __future__ import annotations

import math

#: WGS 84: semi-major axis, m, and first eccentricity squared.
SEMI_MAJOR_M = 6378137.0
ECCENTRICITY_2 = 6.69437999014e-3


def wrapped_rad(angle_rad: float) -> float:
    """The same angle in [-pi, pi]."""
    return math.remainder(angle_rad, math.tau)


def yaw_of_heading(heading_rad: float) -> float:
    """Yaw, rad, of a heading: psi = pi/2 - heading. The inverse is the same function."""
    return wrapped_rad(math.pi / 2 - heading_rad)


heading_of_yaw = yaw_of_heading


def velocity_ned(heading_rad: float, speed_mps: float) -> tuple[float, float]:
    """Velocity to the north and to the east, m/s."""
    return speed_mps * math.sin(heading_rad), speed_mps * math.cos(heading_rad)


def motion_of_ned(north_mps: float, east_mps: float) -> tuple[float, float]:
    """Heading, rad, and speed, m/s, of a velocity."""
    return math.atan2(north_mps, east_mps), math.hypot(north_mps, east_mps)


def local_m(place_deg: tuple[float, float], origin_deg: tuple[float, float]) -> tuple[float, float]:
    """East and north of the origin, m, of a latitude and longitude.

    x = N cos(phi0) (lambda - lambda0), y = M (phi - phi0), with the radii of curvature N, M of WGS 84 at the origin's latitude
    phi0. Within 1 km of the origin, and 70 degrees of the equator, it is wrong by less than 0.25 m.
    """
    latitude, longitude = (math.radians(angle) for angle in place_deg)
    latitude_0, longitude_0 = (math.radians(angle) for angle in origin_deg)
    w = math.sqrt(1 - ECCENTRICITY_2 * math.sin(latitude_0) ** 2)
    across_m = SEMI_MAJOR_M / w
    along_m = SEMI_MAJOR_M * (1 - ECCENTRICITY_2) / w**3
    return across_m * math.cos(latitude_0) * wrapped_rad(longitude - longitude_0), along_m * (latitude - latitude_0)


def position_std_m(xx_m2: float, xy_m2: float, yy_m2: float) -> float | None:
    """Standard deviation, m, in the direction in which a position is least certain; `None` if the covariance is not known."""
    mean, half = (xx_m2 + yy_m2) / 2, (xx_m2 - yy_m2) / 2
    largest = mean + math.hypot(half, xy_m2)
    is_known = math.isfinite(largest) and largest > 0 and min(xx_m2, yy_m2) >= 0
    return math.sqrt(largest) if is_known else None

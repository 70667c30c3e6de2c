#!/usr/bin/env python3
"""A node of another stack: shows where the ship is, with rclpy and standard messages alone; nothing of riins is imported.

Lives here: subscriptions to /nav/odometry, /nav/fix and /imu/data, one line a second.
Does not live here: anything that needs this workspace; copy the file where you like and run it with `python3 navigation_display.py`.

    python3 navigation_display.py                                 until Ctrl-C
    python3 navigation_display.py --ros-args -p lines:=5          five lines, then it ends
    python3 navigation_display.py --ros-args -r __ns:=/ship1      a graph in a namespace
"""

import math
import sys

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, NavSatFix


class NavigationDisplay(Node):
    """Prints position, heading, speed and turn rate once a second of measurement time."""

    def __init__(self) -> None:
        super().__init__("navigation_display")
        self.lines = self.declare_parameter("lines", 0).value
        self.odometry: Odometry | None = None
        self.imu: Imu | None = None
        self.printed = 0
        self.second: int | None = None
        # relative names, so that a namespace moves them; sensor data QoS is enough for a display and matches our reliable publishers
        self.create_subscription(Odometry, "nav/odometry", self.on_odometry, qos_profile_sensor_data)
        self.create_subscription(Imu, "imu/data", self.on_imu, qos_profile_sensor_data)
        self.create_subscription(NavSatFix, "nav/fix", self.on_fix, qos_profile_sensor_data)

    def on_odometry(self, message: Odometry) -> None:
        """Pose in `map` (ENU, origin on /nav/origin), twist in `base_link` (FLU)."""
        self.odometry = message

    def on_imu(self, message: Imu) -> None:
        """Attitude of base_link in ENU, body rates and specific force (REP-145)."""
        self.imu = message

    def on_fix(self, message: NavSatFix) -> None:
        """Latitude and longitude in degrees; with everything else known, one line a second."""
        if self.odometry is None or self.imu is None or message.header.stamp.sec == self.second:
            return
        self.second = message.header.stamp.sec
        velocity = self.odometry.twist.twist.linear
        speed = math.hypot(velocity.x, velocity.y) * 3600.0 / 1852.0
        sigma = math.sqrt(max(message.position_covariance[0] + message.position_covariance[4], 0.0))
        print(
            f"{message.latitude:.6f} {message.longitude:.6f} +- {sigma:.1f} m  heading {heading(self.imu.orientation):05.1f} deg  "
            f"speed {speed:.1f} kn  turn {-math.degrees(self.imu.angular_velocity.z) * 60.0:+.0f} deg/min",
            flush=True,
        )
        self.printed += 1
        if self.printed == self.lines:
            raise SystemExit(0)


def heading(q) -> float:
    """Compass heading in degrees of a REP-103 quaternion: ENU yaw is counter-clockwise from east, heading clockwise from north."""
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return (90.0 - math.degrees(yaw)) % 360.0


def main() -> int:
    """Spin until Ctrl-C or the wanted number of lines."""
    rclpy.init()
    node = NavigationDisplay()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Plays the robots of a run with ROS 2 alone: it drives them by cmd_vel, and publishes odometry and ranges.

Each command moves its robot by one time step; the answer is what the robot measures then. The argument is a file of
arrays: truth (T, 2), noise (T, M), start (M, 2), dt_s, and, for robots with cameras that know where they are in a frame of
their own, bearing_noise (T, M), covariance of x, y and yaw (3, 3) and origin (x, y, yaw). Prints a line of JSON when it is
asked to end.
"""

import json
import math
import sys

import numpy as np
import rclpy
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from ros2_spin import spin
from sensor_msgs.msg import Range


#: The stamp of tick 0.
FIRST_S = 1


class Player(Node):
    def __init__(self, path):
        super().__init__("player")
        data = np.load(path)
        self.truth, self.noise, self.dt_s = data["truth"], data["noise"], float(data["dt_s"])
        self.bearing_noise = data["bearing_noise"] if "bearing_noise" in data else None
        self.covariance = data["covariance"] if "covariance" in data else np.zeros((3, 3))
        self.origin = data["origin"] if "origin" in data else None
        self.robots = [[*place, 0.0, 0.0, 0.0] for place in data["start"].tolist()]
        count = len(self.robots)
        self.steps, self.commands, self.last = [0] * count, [0] * count, [None] * count
        qos = QoSProfile(depth=100)
        self.ranges = [self.create_publisher(Range, f"robot_{i}/range", qos) for i in range(count)]
        self.odometry = [self.create_publisher(Odometry, f"robot_{i}/odom", qos) for i in range(count)]
        self.bearings = [self.create_publisher(Vector3Stamped, f"robot_{i}/bearing", qos) for i in range(count)]
        for i in range(count):
            self.create_subscription(TwistStamped, f"robot_{i}/cmd_vel", lambda message, i=i: self.drive(i, message), qos)
        self.create_timer(0.25, lambda: [self.show(i) for i in range(count)])

    def drive(self, i, message):
        forward, turn = message.twist.linear.x, message.twist.angular.z
        self.last[i] = (forward, turn)
        step = round((message.header.stamp.sec - FIRST_S + message.header.stamp.nanosec * 1e-9) / self.dt_s)
        if step == self.steps[i] and step + 1 < len(self.truth):
            self.commands[i] += 1
            x, y, yaw, *_ = self.robots[i]
            half = turn * self.dt_s / 2
            chord = forward * self.dt_s * (math.sin(half) / half if half else 1.0)
            self.robots[i] = [x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + 2 * half, forward, turn]
            self.steps[i] += 1
        self.show(i)

    def show(self, i):
        step = self.steps[i]
        x, y, yaw, forward, turn = self.robots[i]
        time_ns = FIRST_S * 1_000_000_000 + round(step * self.dt_s * 1e9)
        odometry = Odometry(child_frame_id=f"robot_{i}/base_link")
        odometry.header.frame_id = "map" if self.origin is None else f"robot_{i}/odom"
        odometry.header.stamp.sec, odometry.header.stamp.nanosec = divmod(time_ns, 1_000_000_000)
        own_x, own_y, own_yaw = x, y, yaw
        if self.origin is not None:
            (x0, y0, yaw0), own_yaw = self.origin, yaw - self.origin[2]
            own_x = math.cos(yaw0) * (x - x0) + math.sin(yaw0) * (y - y0)
            own_y = math.cos(yaw0) * (y - y0) - math.sin(yaw0) * (x - x0)
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = own_x, own_y
        odometry.pose.pose.orientation.z, odometry.pose.pose.orientation.w = math.sin(own_yaw / 2), math.cos(own_yaw / 2)
        odometry.pose.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])] = self.covariance
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = forward, turn
        measured = Range(header=odometry.header, radiation_type=Range.ULTRASOUND, max_range=1e6)
        measured.range = max(0.0, float(math.dist(self.truth[step], (x, y)) + self.noise[step, i]))
        if self.bearing_noise is not None:
            dx, dy = self.truth[step] - (x, y)
            bearing = math.atan2(dy, dx) - yaw + self.bearing_noise[step, i]
            direction = Vector3Stamped(header=odometry.header)
            direction.vector.x, direction.vector.y = 3 * math.cos(bearing), 3 * math.sin(bearing)
            self.bearings[i].publish(direction)
        self.odometry[i].publish(odometry)
        self.ranges[i].publish(measured)


def main():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    player = Player(sys.argv[1])
    spin(player)
    print(json.dumps({"commands": player.commands, "last": player.last}), flush=True)


main()

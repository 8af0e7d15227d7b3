"""Sends odometry and ranges of robots with ROS 2 alone, each message once.

The arguments are the number of messages of each topic, the time between two of them, s, and the numbers of the robots. Sends when all
topics have a subscriber. Ends when the diagnostics of each robot count all messages, or when it is asked to: then it prints a line
of JSON, the newest diagnostics of each robot.
"""

import json
import sys

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from ros2_spin import end, spin
from sensor_msgs.msg import Range

#: Time that subscribers have to know the publishers, too, s.
SETTLED_S = 1.0


class Sender(Node):
    def __init__(self, count, period_s, robots):
        super().__init__("sender")
        self.count, self.robots, self.reported = count, robots, {}
        self.number = -round(SETTLED_S / period_s)
        qos = QoSProfile(depth=count)
        self.odometry = [self.create_publisher(Odometry, f"robot_{i}/odom", qos) for i in robots]
        self.ranges = [self.create_publisher(Range, f"robot_{i}/range", qos) for i in robots]
        self.create_subscription(DiagnosticArray, "/diagnostics", self.hear, 100)
        self.create_timer(period_s, self.send)

    def send(self):
        if self.number == self.count or not all(topic.get_subscription_count() for topic in self.odometry + self.ranges):
            return
        self.number += 1
        if self.number <= 0:
            return
        for odometry, ranges in zip(self.odometry, self.ranges):
            placed = Odometry()
            placed.header.frame_id, placed.header.stamp = "map", self.get_clock().now().to_msg()
            placed.pose.pose.position.x = 15.0
            placed.pose.covariance[0] = placed.pose.covariance[7] = 0.01
            odometry.publish(placed)
            ranges.publish(Range(header=placed.header, range=20.0, max_range=100.0))

    def hear(self, message):
        for status in message.status:
            values = {value.key: value.value for value in status.values}
            if "ranges received" in values:
                self.reported[status.name] = values
        received = [int(values[f"{what} received"]) for values in self.reported.values() for what in ("ranges", "odometry")]
        if len(received) == 2 * len(self.robots) and min(received) >= self.count:
            end()


def main():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    count, period_s, *robots = sys.argv[1:]
    sender = Sender(int(count), float(period_s), [int(robot) for robot in robots])
    spin(sender)
    print(json.dumps(sender.reported), flush=True)


main()

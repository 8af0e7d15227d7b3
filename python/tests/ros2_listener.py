"""Counts what a node publishes, with ROS 2 alone. Prints a line at the first message, and one of JSON when it is
asked to end.

The arguments are topics with their types, as in `/target/pose=geometry_msgs/PoseWithCovarianceStamped`. With `use_sim_time`
among them the node has the time of /clock; the line has the node's time in the end, s.
"""

import importlib
import json
import sys

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from ros2_spin import spin


def plain(value):
    """A message as JSON has it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, (str, int, float)):
        return value
    return [plain(one) for one in value]


def main():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    args = [arg for arg in sys.argv[1:] if arg != "use_sim_time"]
    node = Node("listener", parameter_overrides=[Parameter("use_sim_time", value=len(args) < len(sys.argv) - 1)])
    heard = {}

    def hear(topic, message):
        if not any(heard.values()):
            print("first", flush=True)
        heard[topic].append(message)

    for arg in args:
        topic, _, kind = arg.partition("=")
        package, _, name = kind.partition("/")
        heard[topic] = []
        best_effort = ReliabilityPolicy.BEST_EFFORT if topic == "/clock" else ReliabilityPolicy.RELIABLE
        qos = QoSProfile(depth=5000, reliability=best_effort)
        node.create_subscription(getattr(importlib.import_module(f"{package}.msg"), name), topic, lambda message, topic=topic: hear(topic, message), qos)
    executor = spin(node)
    # On a busy machine messages wait to be taken.
    count = -1
    while count < (count := sum(map(len, heard.values()))):
        for _ in range(200):
            executor.spin_once(timeout_sec=0.005)
    messages_by_topic = {topic: [plain(message) for message in messages] for topic, messages in heard.items()}
    print(json.dumps({**messages_by_topic, "now_s": node.get_clock().now().nanoseconds * 1e-9}), flush=True)


main()

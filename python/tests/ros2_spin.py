"""The common parts of the processes that know ROS alone."""

import signal

from rclpy.executors import SingleThreadedExecutor


class Ended(Exception):
    pass


def end(*_):
    raise Ended


def spin(node):
    """Says that a node is ready, and calls its callbacks until this process is asked to end. Returns the executor."""
    signal.signal(signal.SIGTERM, end)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    print("ready", flush=True)
    try:
        # Python acts on signals between two waits.
        while True:
            executor.spin_once(timeout_sec=0.1)
    except Ended:
        return executor

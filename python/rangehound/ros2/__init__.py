"""A node of ROS 2 for a live run: `python -m rangehound.ros2 --name RUN`.

Only the modules `session`, `observer` and `robot` need rclpy, and they import it when they start. The others are plain
computations:

================  =========================================================
`messages`        from the arrays of a tick to the fields of messages
`measurements`    from the fields of messages to measurements, or a refusal
`unicycle`        from a heading and a speed to a twist
================  =========================================================
"""

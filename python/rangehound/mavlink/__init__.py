"""A robot that is an ArduPilot or PX4 vehicle: `python -m rangehound.mavlink --name RUN --id N --connect URL`.

==========  ================================================================================
`frames`    between a run's frame (east, north) and MAVLink's (north, east, down), no I/O
`vehicle`   the state that the vehicle reports, and the setpoint that it gets now, no I/O and no clock
`link`      the thread that reads and writes the connection
==========  ================================================================================
"""

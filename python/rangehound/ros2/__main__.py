"""`python -m rangehound.ros2`."""

import sys

from .observer import main
from .session import run_node

sys.exit(run_node(main))

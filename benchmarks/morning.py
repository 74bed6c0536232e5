"""A morning with the hand, command by command: zero, home, hand over, play, a fault, off, back from here, play again.

    python benchmarks/morning.py my.plan.json

On fifteen simulated drives that were switched on just now, whose motors move a hand in physics: nobody but its fingers
holds the object once it was handed over. Every joint stands at 0 deg, which is how the zeros are told.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "epos"))
from morning_commands import commands, morning

plan = Path(sys.argv[1])
sys.exit(morning(plan)[0] != [command.status for command in commands(plan)])

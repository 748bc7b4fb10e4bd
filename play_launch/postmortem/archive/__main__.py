"""``python -m play_launch.postmortem.archive``."""

import sys

from play_launch.postmortem.archive import main

sys.exit(main())

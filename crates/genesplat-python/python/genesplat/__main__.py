"""`python -m genesplat` is the command."""

from __future__ import annotations

import sys

from genesplat._command import main

sys.exit(main())

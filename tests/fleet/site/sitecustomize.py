"""Install the stub of the engine in every process with this folder on its path."""

import os

from tests.fleet.stub import JOURNAL, install

if JOURNAL in os.environ:
    install()

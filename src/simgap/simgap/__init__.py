"""Diagnosis of the sim-to-real gap of any MuJoCo model: where it lies, which effect causes it, how far it shrinks.

Folders import downwards only: ``data``, ``execution``, ``simulation``, ``effects``, ``inference``, ``analysis``,
``correction``, ``preparation``, ``monitoring``, ``report``, then ``blind`` and ``examples``.
"""

__version__ = "0.1.0"

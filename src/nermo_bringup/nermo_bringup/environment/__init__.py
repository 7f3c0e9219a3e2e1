"""The ground that Nermo stands on: system packages, the Python environment, the built workspace.

Everything here runs before anything is installed and so imports the standard library only.
"""

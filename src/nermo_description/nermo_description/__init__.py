"""The robots as data: modular MJCF, meshes, URDF, parameter files, and the loader that turns them into a model."""

from nermo_description.opengl import choose_opengl

choose_opengl()

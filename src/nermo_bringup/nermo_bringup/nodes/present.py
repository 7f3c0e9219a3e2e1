"""Who else is in the graph."""

from __future__ import annotations

from rclpy.node import Node


def others(node: Node) -> set[str]:
    """Full names of the nodes beside this one, as far as discovery has come."""
    found = {f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()}
    return found - {node.get_fully_qualified_name()}

"""Nodes: whatever imports rclpy."""

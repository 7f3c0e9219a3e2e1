"""What an outside tracker may see of the mouse beside base_link: a marker on each foot and one on the rear torso."""

from __future__ import annotations

from nermo_description.parameters import LEGS

MARKERS = {**{f"{leg}_foot": ("site", f"{leg}_foot") for leg in LEGS}, "rear_torso": ("body", "rear_torso")}
"""Each marker's place, and the frame of the model where it is glued: its kind and name."""
MARKER_TOPIC = "tracker/markers/{place}"
"""Below the mouse's namespace: `geometry_msgs/PointStamped`, or `PoseWithCovarianceStamped` by who knows how sure."""

"""Reading recordings; the reader itself lives below all packages that read them."""

from nermo_node.recording import RawMessage, Recording, TopicData, TopicInfo, recording_file

__all__ = ["RawMessage", "Recording", "TopicData", "TopicInfo", "recording_file"]

"""Recordings: MCAP bags as rosbag2 lays them out, written so that a kill loses at most half a second."""

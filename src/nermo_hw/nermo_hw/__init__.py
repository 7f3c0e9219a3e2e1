"""The real robot's path: SBCP protocol, serial driver, Wi-Fi link and safety supervisor."""

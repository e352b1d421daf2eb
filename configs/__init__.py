"""The settings that ship with mqslam, one YAML file per radar."""

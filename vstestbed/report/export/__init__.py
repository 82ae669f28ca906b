"""Recorded runs for other tools: MCAP (`mcap_file`), LeRobot datasets (`lerobot`), CSV
(`csv_files`), all of a `RecordedRun` (`source`).
"""

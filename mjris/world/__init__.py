"""The physical side: office, rover, people and lines of sight."""

"""Everything that uses MAVLink: dialect, frames, links, recordings, and records."""

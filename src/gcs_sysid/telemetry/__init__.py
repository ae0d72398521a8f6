"""Everything that speaks MAVLink: dialect, frames, links, recordings, and records."""

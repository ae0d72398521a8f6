"""Running sessions: the live one and the replay of a log, as immutable snapshots."""

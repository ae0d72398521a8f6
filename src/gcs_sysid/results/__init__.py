"""What an identification found: results, their files, snapshots, and comparisons."""

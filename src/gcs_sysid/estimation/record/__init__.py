"""What a flight leaves behind for fits, in bounded memory."""

"""The one room that judges: objections of all producers to statuses, verdict and reasons."""

"""What rows are noisy with: whiteners, colored residuals."""

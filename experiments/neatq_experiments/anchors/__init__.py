"""What one would otherwise take, run beside the arms of `neatq compare`."""

"""What a trained policy is worth: in its environment, or on episodes that training never saw."""

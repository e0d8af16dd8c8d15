"""Who records data."""

from guider.errors import GuiderError


def check_steps(steps: int) -> None:
    """Raises GuiderError if `steps` is below 2."""
    if steps < 2:
        raise GuiderError(f"cannot record {steps} steps: an episode needs at least two")

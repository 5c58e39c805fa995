"""One thing that was found about a capture."""

from dataclasses import dataclass

ERROR, WARNING, NOTE = "error", "warning", "note"


@dataclass(frozen=True)
class Finding:
    """What contradicts what, by which number, and what to do."""

    severity: str  # ERROR, WARNING or NOTE
    name: str  # such as "jitter in motion"
    where: str  # the frame, or empty: all of them
    evidence: str  # promise, observation, number
    remedy: str

    @property
    def sentence(self) -> str:
        """Returns all of it in one line."""
        place = f" ({self.where})" if self.where else ""
        return f"{self.name}{place}: {self.evidence}; {self.remedy}"

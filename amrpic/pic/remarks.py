"""What a run says of itself: what it chose, and what is legal and yet may not be meant."""

from __future__ import annotations

from ..particles.energy_bins import Frames
from ..particles.frame import STATIC
from ..scene.motion import Motion

LARGE = 0.01  # estimated error of the self-field's force that draws a remark


class Remarks:
    """Sentences, each once: `notes` of what the run chose by itself, `warnings` of what is legal and yet may not be meant."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self.notes: list[str] = []
        self._kinds: set[str] = set()
        self._noted, self._warned = (1, 0.0), 0.0  # frames and error of the self-field that notes and remarks have

    def note(self, sentence: str) -> None:
        """Note what the run chose by itself, once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def remark(self, sentence: str, kind: str = "") -> None:
        """Note something that is legal and yet may not be meant, once; of those of a `kind` only the first."""
        if sentence not in self.warnings and (not kind or kind not in self._kinds):
            self._kinds.add(kind)
            self.warnings.append(sentence)

    def on_frames(self, frames: Frames, motion: Motion) -> None:
        """Note in how many frames the self-field is solved for and the estimated error, again where either grew by much."""
        count, error = len(frames.members), frames.error
        if (count > 1 or error > STATIC) and (count != self._noted[0] or error > 2 * self._noted[1]):
            self._noted = (count, max(error, STATIC))
            self.note(
                f"motion.energy_bins: {count} for the self-field; the motion that they leave out makes an error of about "
                f"{error:.1%} of its force"
            )
        if error > max(LARGE, 2 * self._warned):
            self._warned = error
            if (motion.frame, motion.energy_bins) != ("auto", "auto") and error > 2 * frames.across:
                remedy = 'set motion.frame and motion.energy_bins to "auto"'
            else:
                remedy = "momenta of the charge in its own frame make it so; codes that solve Maxwell's equations follow them"
            self.remark(
                f"the self-field is solved for in {count} frame{'s' * (count > 1)} (motion.energy_bins), and its force may be "
                f"off by about {error:.1%}; {remedy}"
            )

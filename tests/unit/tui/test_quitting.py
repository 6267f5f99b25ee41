"""What is asked before the screen closes: nothing that runs ends by an Enter too many."""

from pathlib import Path

from textual.widgets import Button, Static

from capture_app.common.text import ProgressStep
from capture_app.tui.app import quit_question
from capture_app.tui.jobs.run import Run, RunState
from tests.unit.tui.driving import make_app, running, settle
from tests.unit.tui.fake_rig import FakeRig, make_node


async def test_a_running_job_is_named_with_how_far_it_is_and_staying_comes_first(tmp_path: Path) -> None:
    rig = FakeRig()
    rig.nodes = (make_node("cam00", on_leader=True),)
    run = Run(
        kind="compare",
        session=tmp_path / "burst-001",
        state=RunState.RUNNING,
        step=ProgressStep(2, 9, "scale"),
    )
    app = make_app(rig)
    async with running(app, 100, 30) as pilot:
        question = quit_question(rig.status(), started=True, local=True, jobs=(str(run),))
        assert question is not None
        app.push_screen(question)
        await settle(pilot)
        assert "Compare of burst-001 (11 %) ends with the screen" in str(
            question.query_one(".question", Static).content
        )
        labels = [str(button.label) for button in app.screen.query(Button)]
        assert labels == ["n Stay here", "l Leave the rig running, end the job", "s Stop the rig"]
        await pilot.press("enter")
        assert app.screen is not question
        assert app.is_running

"""A hand of meshes with a wrist below its palm and frames for fingertips: its hand file as proposed, unedited."""

from drake_hand import api
from drake_hand.model.check import check_hand, write_proposal
from drake_hand.plans.task import Grasp, Options, Physics, Pose, Rotate, Step, Task


def test_orca_turns_a_rod_in_equilibrium(models, tmp_path):
    file = tmp_path / "orca.hand.yaml"
    write_proposal(models / "hands/orca_v1/v1/models/urdf/orcahand_right.urdf", file)
    assert not check_hand(file).problems
    rod = tmp_path / "rod.urdf"
    shape = '<collision><geometry><cylinder radius="0.015" length="0.12"/></geometry></collision>'
    rod.write_text(f'<robot name="rod"><link name="rod">{shape}</link></robot>')
    task = Task(
        hand=str(file),
        object=str(rod),
        start=Pose(xyz_mm=(50.0, 73.0, 17.0), rpy_deg=(-75.0, 12.0, 114.0)),  # one that `start: auto` finds
        motion=[Step(grasp=Grasp()), Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=90.0))],
        physics=Physics(gravity=(0.0, -9.81, 0.0)),
        options=Options(time_limit_s=180.0),
    )
    assert api.solve(task).plan.certified

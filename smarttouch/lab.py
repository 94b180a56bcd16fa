"""API for studies: models of skin and nerves, instruments, experiments and figures."""

from smarttouch.base.afferent import CLASS_COLORS as CLASS_COLORS
from smarttouch.base.files import data_folder as data_folder
from smarttouch.braille.code_tables import open_table as open_table
from smarttouch.braille.page_layout import lay_out as lay_out
from smarttouch.experiments.answer_file import read_table as read_table
from smarttouch.experiments.answer_file import usual_model as usual_model
from smarttouch.experiments.experiment_session import open_experiment as open_experiment
from smarttouch.experiments.findings import (
    discrimination_figure as discrimination_figure,
)
from smarttouch.experiments.findings import judge_answers as judge_answers
from smarttouch.experiments.observers import make_observer as make_observer
from smarttouch.experiments.procedures import Condition as Condition
from smarttouch.experiments.simulated_study import Study as Study
from smarttouch.experiments.simulated_study import run_study as run_study
from smarttouch.experiments.simulated_study import study_sums as study_sums
from smarttouch.experiments.simulated_study import study_table as study_table
from smarttouch.experiments.standard_experiments import Experiment as Experiment
from smarttouch.experiments.trials import Answer as Answer
from smarttouch.experiments.trials import Setup as Setup
from smarttouch.experiments.trials import Trial as Trial
from smarttouch.experiments.trials import ask as ask
from smarttouch.experiments.trials import in_two_intervals as in_two_intervals
from smarttouch.imaging.reading_profile import profile_for_reading as profile_for_reading
from smarttouch.imaging.reading_profile import reading_force_n as reading_force_n
from smarttouch.instruments.electric_mouse import MouseSource as MouseSource
from smarttouch.instruments.electric_mouse import open_motion_over as open_motion_over
from smarttouch.instruments.relief import open_texture as open_texture
from smarttouch.instruments.vibration_stimuli import mix_colors as mix_colors
from smarttouch.instruments.vibration_trace import open_trace as open_trace
from smarttouch.pages.prepared_page import print_text as print_text
from smarttouch.physiology.activating_function import depth_mm as depth_mm
from smarttouch.physiology.activating_function import field_at as field_at
from smarttouch.physiology.activating_function import line_in_plane as line_in_plane
from smarttouch.physiology.activating_function import potential_mv as potential_mv
from smarttouch.physiology.membrane import Axon as Axon
from smarttouch.physiology.membrane import DrivingFunction as DrivingFunction
from smarttouch.physiology.membrane import Fiber as Fiber
from smarttouch.physiology.membrane import threshold_ma as threshold_ma
from smarttouch.physiology.membrane import weiss_fit as weiss_fit
from smarttouch.reading.braille_lines import Braille as Braille
from smarttouch.reading.letter_shapes import Shapes as Shapes
from smarttouch.reading.line_source import ReadingSource as ReadingSource
from smarttouch.reading.reading_material import ReadingMaterial as ReadingMaterial
from smarttouch.running.replay_check import assert_replays as assert_replays
from smarttouch.running.replay_check import check_recording as check_recording
from smarttouch.views.figure_style import ANODIC as ANODIC
from smarttouch.views.figure_style import CATHODIC as CATHODIC
from smarttouch.views.figure_style import GREY as GREY
from smarttouch.views.kernel_figures import draw_field as draw_field
from smarttouch.views.kernel_figures import draw_weights as draw_weights
from smarttouch.views.kernel_figures import electrode_patches as electrode_patches
from smarttouch.views.kernel_figures import kernel_figure as kernel_figure

"""What shows: figures, the report, the explorer."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "explorer.server": "ExploreServer Handler MOST_BYTES MOST_CONNECTIONS page points static_page",
    "explorer.session": "GROUPS HORIZON Session answer_data sliders_of",
    "figures.continua": "held_panels panels_figure ringing_of vibration_panels",
    "figures.figures": "comparison_data comparison_figure gap_figure phase_pairs price_figure result_data "
    "result_figure spectra_figure states_figure",
    "figures.look": "MOST_DRAWN REFERENCE STYLES THEMED THEMED_TINTS TINTS thin_out",
    "figures.modes": "adjoint_figure shade_modes strip_rows strips_figure",
    "figures.plot_data": "PlotData Span joint_rows spans view",
    "report.findings": "faults finding_of stop_band_meaning",
    "report.page": "Drawing PIXELS_PER_INCH draw_figures drawing_of render_page save_problem_page save_report tiles",
    "report.proof": "adjoint_caption modes_caption parts_of_the_gap search_sentences switching_sentences verdict",
    "report.tables": "NOT_MEANINGFUL certificate_table comparison_rows comparison_table moves_rows moves_sentence "
    "sweep_table worst_location",
    "units": "align frequency_scale quantity rough time_scale",
})

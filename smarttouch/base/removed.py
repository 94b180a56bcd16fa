"""What 1.0.0rc1 had and this version has not, with what to use instead; goes with the next version.

The same tables are on the page "Install", section "From 1.0rc1".
"""

COMMANDS = {
    "calibrate level": "set the level with the keys + and - during a run",
    "profiles copy": "run smarttouch profiles new FILE.toml --like NAME",
    "recordings": "replay FILE --info shows what it holds, st.load_recording(FILE) has its arrays",
    "report": "send smarttouch --version, pip list and the command that went wrong",
    "simulate letters": "run smarttouch simulate study with a plan of letters",
}
OPTIONS = {
    "--adaptive": "run smarttouch experiment run 'detection?procedure=questplus&site=N'",
    "--bank": "leave it out; kernels are kept where runs find them",
    "--compare": "design one kind after the other; the profile's output.kind decides",
    "--dark": "give --source; the sensor is covered when it asks",
    "--diameter": "give a table with a column diameter_mm",
    "--dot-pitch-mm": "leave it out; the target suits the sensor's field",
    "--finger": "give --set finger=[ANATOMY:]SEED",
    "--frames": "leave it out; 16 frames are averaged",
    "--function": "leave it out; the curve is the cumulative normal, as in the paper",
    "--guess": "leave it out; usual_model of smarttouch.lab takes it",
    "--help-all": "--help prints all options",
    "--lapse": "leave it out; a tenth of the answers may be lapses",
    "--light-on-dark": "give --set light_on_dark",
    "--leave-out": "leave it out; characters without cells are always left out and named",
    "--linear": "leave it out; the comparisons determine the axis",
    "--log": "leave it out; the comparisons determine the axis",
    "--note": "give --set note=WORDS; experiment run has --session",
    "--overwrite": "remove the file, or give another name",
    "--password": "give --password-file FILE, or answer at the terminal",
    "--quiet": "send the output elsewhere, as by > /dev/null",
    "--rate": "give --set rate_hz=HZ; an experiment takes 'NAME?rate_hz=HZ'",
    "--repeats": "leave it out; contact is measured five times, thresholds three times",
    "--robust": "leave it out; kernels are designed for the nominal finger",
    "--save": "record with smarttouch live SOURCE --record FILE.mcap",
    "--schema": "st.Profile.model_json_schema() in Python has it",
    "--seed": "give --set seed=N; the names in an experiment set the order of its trials",
    "--size-mm": "leave it out; the target suits the sensor's field",
    "--standard": "name the column standard in the file",
    "--stream": "run examples/bridges/lsl_bridge.py",
    "--subject": "give --set subject=NAME; experiment run has --subject",
    "--three-state": "leave it out; the profile's output.kind decides",
    "--vibrators": "give --set vibrators=FILE.wav or --set vibrators=sound:",
    "--weights": "type each weight when it is asked for",
    "--white": "give --source; the sensor is put on white paper when it asks",
    "--yes": "press Enter when everything is in place",
}
URLS = {
    "draw": "send patterns to socket:PATH, or by Session.put in Python",
    "lsl": "run examples/bridges/lsl_bridge.py, or send JSON lines to socket:PATH",
    "mcap": "run examples/bridges/mcap_bridge.py; a recording of a run is recording:FILE",
    "osc": "run examples/bridges/osc_bridge.py, or send JSON lines to socket:PATH",
    "recorded": "replay a run by recording:FILE, or state a force by fixed:N",
    "vibrators": "give --set vibrators=FILE.wav or --set vibrators=sound:",
}
PROFILE_KEYS = {
    "kernels.anatomy": "remove it; kernels are designed for nodes",
    "kernels.fingers": "remove it; kernels are designed for nodes",
    "kernels.objective": "remove it; kernels are designed for nodes",
    "perception.anatomy": "remove it, and choose the simulated finger with --set finger=SEED",
    "perception.level": "remove it, and set the level with the keys during a run",
    "skin.layers": "remove it; set medium = 'half-space' and conductivity_s_per_m",
    "skin.spread": "remove it; kernels are designed for the nominal finger",
}


def instead_of(table: dict[str, str], name: str) -> str | None:
    """Return the sentence that tells what to use instead of a name; None if it was not removed."""
    instead = table.get(name)
    return instead and f"{name} was removed after 1.0.0rc1: {instead}"

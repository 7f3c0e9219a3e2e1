"""The word `track` of the `nermo` command: sheets to print, a camera to calibrate, films to follow the mouse in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from nermo_description.results import CommandError, write_results
from nermo_track.telling import check_seconds, print_rows, progress, save_table, told

if TYPE_CHECKING:
    from nermo_track.camera import Camera
    from nermo_track.fuse import Poses
    from nermo_track.top import Overlooked
    from nermo_track.work import Shot, Tracked

# What does the work takes seconds to import, and help is asked for often: commands import it when they run.

Json = Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")]
Tags = Annotated[
    Path | None, typer.Option(help="YAML file that says where tags sit; by default those of `nermo track sheet`.")
]
LineDelay = Annotated[
    float | None, typer.Option(help="Rolling shutter: seconds from one row to the next, as the maker tells it.")
]
Exposure = Annotated[float | None, typer.Option(help="Seconds for which a row is exposed.")]
Fps = Annotated[float | None, typer.Option(help="Pictures a second, where the file does not tell the true rate.")]

track_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="The pose of the mouse out of film.",
)
bench_app = typer.Typer(
    rich_markup_mode=None, add_completion=False, help="Measure the tracker on films that are drawn."
)


@track_app.callback()
def track() -> None:
    """The pose of the mouse out of film: print tags, calibrate the camera, film, and diagnose what was filmed."""


@track_app.command("sheet")
def sheet(
    out: Annotated[Path, typer.Option(help="The .pdf, or .png of one page, to write.")],
    what: Annotated[Literal["all", "mouse", "markers", "floor", "board"], typer.Option(help="Which pages.")] = "all",
    tags: Tags = None,
) -> None:
    """Draw the tags to print, true to scale on A4: for the mouse's back, its paws, the floor, and the camera's board.

    \b
    nermo track sheet --out tags.pdf
    nermo track sheet --what board --out board.png
    """
    with told():
        from nermo_track.layout import load_layout
        from nermo_track.sheet import KINDS, write_sheets

        write_sheets(out, KINDS if what == "all" else [what], load_layout(tags))
    typer.echo(f"{out}: print it at 100 %, and measure the line of 100 mm on it")


@track_app.command("calibrate")
def calibrate(
    film: Annotated[Path, typer.Argument(help="A film of the board, held everywhere in the picture and tilted.")],
    out: Annotated[Path, typer.Option(help="The camera's file to write.")],
    line_delay: LineDelay = None,
    exposure: Exposure = None,
    square_mm: Annotated[float, typer.Option(min=1.0, max=500.0, help="Edge of a square, as measured.")] = 28.0,
    json: Json = None,
) -> None:
    """Fit a camera to a film of the board. Refuses, with exit status 1, where the film does not tell it well enough.

    Zoom, focus and size of the picture must be those of the films of the mouse.

    \b
    nermo track calibrate board.mp4 --out camera.yaml
    nermo track calibrate board.mp4 --out camera.yaml --line-delay 1.5e-5 --exposure 0.004
    """
    with told(), progress() as say:
        from nermo_track.calibrate import calibrate as fit
        from nermo_track.camera import save_camera
        from nermo_track.errors import TrackError
        from nermo_track.film import Film

        check_seconds("--line-delay", line_delay, 1e-3)
        check_seconds("--exposure", exposure, 1.0)
        opened = Film(film)
        try:
            found = fit(opened, line_delay or 0.0, exposure or 0.0, 1e-3 * square_mm, lambda share: say("board", share))
        except TrackError as error:
            raise CommandError(str(error)) from error
        save_camera(found.camera, out)
    typer.echo(
        f"{out}: {found.camera.width} x {found.camera.height} px, focal length {found.camera.fx:.1f} px "
        f"(± {100.0 * found.focal_deviation:.2f} %)\n"
        f"reprojection error {found.rms:.2f} px in {found.views} views (worst {found.worst_view:.2f} px), which cover "
        f"{100.0 * found.coverage:.0f} % of the picture"
    )
    if json is not None:
        facts = {
            "camera": found.camera.model_dump(),
            "focal_deviation": found.focal_deviation,
            "worst_view_px": found.worst_view,
        }
        write_results(json, "track-calibrate", facts)


@track_app.command("film")
def film(
    films: Annotated[list[Path], typer.Argument(help="Films of one run, each of a camera that stands still.")],
    camera: Annotated[list[Path], typer.Option(help="File of `calibrate`: one for all films, or one for each.")],
    out: Annotated[Path, typer.Option(help="New folder for the recording; without --recording a .csv of the poses.")],
    recording: Annotated[
        Path | None, typer.Option(help="What the mouse was told meanwhile: the folder of a recording, or of a segment.")
    ] = None,
    robot: Annotated[str | None, typer.Option(help="Name or file; by default what the recording says.")] = None,
    tags: Tags = None,
    fps: Fps = None,
    line_delay: LineDelay = None,
    exposure: Exposure = None,
    clock_from: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="Fit the clock to this part of the recording, [s] from the first command: steps in the stand."
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Follow the mouse through films, and write where it was beside what it was told, for `nermo gap diagnose`.

    The film's clock is fitted to the recording's commands. The recording given is left as it is. Refuses where the
    clock cannot be told; film a stand, a start and a stop.

    \b
    nermo track film walk.mp4 --camera camera.yaml --recording recordings/today --out recordings/filmed
    nermo track film left.mp4 right.mp4 --camera left.yaml --camera right.yaml --recording recordings/today --out filmed
    nermo track film slow.mp4 --fps 240 --exposure 0.001 --camera camera.yaml --out poses.csv
    """
    with told():
        from nermo_track.layout import load_layout
        from nermo_track.work import follow, into_recording, poses_of

        shots, layout = _shots(films, camera, fps, line_delay, exposure), load_layout(tags)
        if recording is None:
            if len(shots) > 1 or clock_from is not None or out.suffix != ".csv":
                raise CommandError(
                    "without --recording: give one film, no --clock-from, and --out a .csv file", status=2
                )
            with progress() as say:
                tracked = [follow(shots[0], layout, say)]
            _save_poses(out, poses_of(tracked[0].track, None))
            said, name = [f"{out}: {len(tracked[0].track.time)} poses in the film's own time"], None
        else:
            with progress() as say:
                written = into_recording(shots, layout, recording, out, robot, say, clock_from)
            tracked, name = written.films, written.robot
            said = [
                f"cameras are {1e3 * apart.position:.1f} mm and {57.29578 * apart.angle:.2f} degrees apart"
                for apart in written.apart
            ]
            said.append(f"{out}: {written.poses} poses of {name} as {written.topic}")
            said += [f"{out}: {count} places of {place}" for place, count in written.markers.items()]
            said.append(f"next: nermo gap diagnose {out}")
    for one in tracked:
        _print_film(one)
    for line in said:
        typer.echo(line)
    if json is not None:
        write_results(json, "track", {"films": [one.report() for one in tracked], "out": str(out)}, robot=name)


@track_app.command("top")
def top(
    film: Annotated[Path, typer.Argument(help="A film of a camera that stands still and looks down on the mouse.")],
    out: Annotated[Path, typer.Option(help="The .csv of its way to write.")],
    camera: Annotated[Path | None, typer.Option(help="File of `calibrate`; not needed with --scale.")] = None,
    height: Annotated[
        float | None, typer.Option(min=0.05, max=20.0, help="Of the camera over the floor [m], looking straight down.")
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(min=1e-5, max=0.1, help="[m/px] in the middle of the picture, at the height of the mouse's back."),
    ] = None,
    floor: Annotated[
        Path | None, typer.Option(help="A film or picture of the floor without the mouse; else the film's median.")
    ] = None,
    back: Annotated[
        float, typer.Option(min=0.0, max=0.3, help="Height of the mouse's widest part over the floor [m].")
    ] = 0.055,
    window: Annotated[float, typer.Option(min=0.05, max=10.0, help="Seconds over which its way is smoothed.")] = 0.8,
    tags: Tags = None,
    fps: Fps = None,
    line_delay: LineDelay = None,
    exposure: Exposure = None,
    json: Json = None,
) -> None:
    """Follow a mouse without tags from above: where it is, its heading, its speed along it, and its lateral drift.

    The mouse is what moves before the still floor. The floor's tags tell the scale; without them give the camera's
    height, or the scale itself.

    \b
    nermo track top walk.mp4 --camera camera.yaml --out way.csv
    nermo track top walk.mp4 --camera camera.yaml --height 1.2 --out way.csv
    nermo track top walk.mp4 --scale 0.0015 --floor floor.png --out way.csv
    """
    with told():
        from nermo_track.layout import load_layout
        from nermo_track.top import View, overlook

        if out.suffix != ".csv":
            raise CommandError(f"--out: is {out}; must end in .csv", status=2)
        if height is not None and scale is not None:
            raise CommandError("--height and --scale: give one of them, for each tells the scale", status=2)
        known = None if camera is None else _camera(camera, line_delay, exposure)
        view = View(film, known, fps, height, scale, floor, back, window)
        with progress() as say:
            found = overlook(view, load_layout(tags), say)
        names = "t,x,y,heading,speed,sideways,drift,sd_x,sd_y,sd_heading,sd_speed,sd_sideways,sd_drift"
        save_table(out, names, found.way.table())
    _print_way(found)
    typer.echo(f"{out}: {len(found.way.time)} places")
    if json is not None:
        write_results(json, "track-top", {"film": found.report(), "out": str(out)})


@track_app.command("live")
def live(
    camera: Annotated[str, typer.Argument(help="A device (0, /dev/video0), or a URL: http (Motion JPEG), rtsp.")],
    out: Annotated[Path, typer.Option(help="The film to write, .mkv; its times go beside it.")],
    seconds: Annotated[float | None, typer.Option(min=0.1, help="How long to film; else until Ctrl-C.")] = None,
    size: Annotated[
        tuple[int, int] | None, typer.Option(help="Width and height to ask a device for: those of the calibration.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(min=1.0, max=1000.0, help="Pictures a second to ask a device for.")
    ] = None,
    tags: Tags = None,
    json: Json = None,
) -> None:
    """Film with a camera that is plugged in or in the network. The film it leaves is used as any other.

    Pictures are stamped by this computer's clock as they come, and kept grey and without loss. A line says how it
    goes: pictures a second, how many were dropped, which tags are seen.

    \b
    nermo track live 0 --size 1280 720 --out walk.mkv
    nermo track live http://phone.local:8080/video --seconds 30 --out walk.mkv
    nermo track film walk.mkv --camera camera.yaml --out poses.csv
    """
    with told():
        from rich.console import Console

        from nermo_track.layout import load_layout
        from nermo_track.live import Source, film_live

        layout, console = load_layout(tags), Console(markup=False, stderr=True)
        with console.status(f"{camera}: opening") as status:
            source = Source(camera, size, rate)
            filmed = film_live(source, out, layout, seconds, lambda said: status.update(said.sentence(layout.ids)))
    typer.echo(f"{out}: {filmed.width} x {filmed.height} px, {filmed.said.sentence(layout.ids)}")
    if json is not None:
        facts = {
            "film": str(out),
            "pictures": filmed.said.pictures,
            "seconds": filmed.said.seconds,
            "dropped": filmed.said.dropped,
            "ended": filmed.ended,
        }
        write_results(json, "track-live", facts)
    if filmed.ended is not None:
        raise CommandError(f"{filmed.ended}; the {filmed.said.seconds:.1f} s until then are in {out}")


@bench_app.callback()
def bench() -> None:
    """Measure the tracker."""


@bench_app.command("track")
def bench_track(
    robot: Annotated[str, typer.Option(help="nermo, nermo_lite or a parameter file.")] = "nermo_lite",
    top: Annotated[bool, typer.Option("--top", help="Of a mouse without tags, from above.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer cameras and shorter films.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the pictures' noise.")] = 0,
    json: Json = None,
) -> None:
    """Draw films of a walk whose truth is known, from several places, and say how far the tracker is off.

    \b
    nermo bench track
    nermo bench track --quick --json track.json
    nermo bench track --top
    """
    with told(), progress() as say:
        from nermo_track.bench.command import bench
        from nermo_track.bench.top import bench_top

        rows = (bench_top if top else bench)(robot, quick, seed, say)
    print_rows(rows)
    if json is not None:
        write_results(json, "bench-track-top" if top else "bench-track", {"rows": rows}, robot=robot, seed=seed)


def _shots(
    films: list[Path], cameras: list[Path], fps: float | None, line_delay: float | None, exposure: float | None
) -> list[Shot]:
    """Each film with its camera, and what is said of its times."""
    from nermo_track.work import Shot

    if len(cameras) not in (1, len(films)):
        raise CommandError(f"--camera: {len(cameras)} of them for {len(films)} films; give one, or one for each", 2)
    loaded = [_camera(path, line_delay, exposure) for path in cameras]
    return [Shot(path, loaded[k % len(loaded)], fps) for k, path in enumerate(films)]


def _camera(path: Path, line_delay: float | None, exposure: float | None) -> Camera:
    """A camera's file, with times that are said beside it."""
    from nermo_track.camera import load_camera

    check_seconds("--line-delay", line_delay, 1e-3)
    check_seconds("--exposure", exposure, 1.0)
    own = {"line_delay": line_delay, "exposure": exposure}
    return load_camera(path).model_copy(update={name: value for name, value in own.items() if value is not None})


def _print_film(one: Tracked) -> None:
    """What was found in a film."""
    found, clock = one.track, one.clock
    facts = one.report()
    place, turn = facts["position_sd_mm"], facts["rotation_sd_deg"]
    typer.echo(f"{one.shot.film}: {found.missing.sentence()}")
    typer.echo(
        f"  corners ± {found.corner_deviation:.2f} px, smeared by {found.blur:.2f} px; "
        f"base_link ± {place[0]:.2f}, {place[1]:.2f}, {place[2]:.2f} mm, "
        f"± {turn[0]:.2f}, {turn[1]:.2f}, {turn[2]:.2f} degrees (x, y, z)"
    )
    for place, marker in facts["markers"].items():
        x, y, z = marker["position_sd_mm"]
        seen = f"in {marker['poses']} of {facts['pictures']} pictures"
        typer.echo(f"  {place}: {seen}, ± {x:.2f}, {y:.2f}, {z:.2f} mm (x, y, z)")
    if clock is not None:
        typer.echo(
            f"  its first picture is {clock.offset:.4f} s after the first command, ± {1e3 * clock.deviation:.1f} ms; "
            f"rate {1e6 * clock.rate:+.0f} ppm; the commands explain {100.0 * clock.agreement:.0f} % of what is seen"
        )
    for warning in (*found.warnings(), *(clock.warnings() if clock is not None else ())):
        typer.echo(f"  warning: {warning}", err=True)


def _save_poses(out: Path, poses: Poses) -> None:
    """Poses as a table with a header."""
    import numpy as np

    turn = poses.rotation.as_quat(scalar_first=True)
    deviation = np.sqrt(np.diagonal(poses.covariance, axis1=1, axis2=2))
    names = "t,base_x,base_y,base_z,base_qw,base_qx,base_qy,base_qz,sd_x,sd_y,sd_z,sd_roll,sd_pitch,sd_yaw"
    save_table(out, names, np.column_stack([poses.time, poses.position, turn, deviation]))


def _print_way(one: Overlooked) -> None:
    """What was found in a film from above."""
    facts, found = one.report(), one.way
    typer.echo(f"{one.view.film}: {found.unseen.sentence()}")
    typer.echo(
        f"  {1e3 * found.along:.0f} mm ahead at {1e3 * found.mean_speed:.1f} ± "
        f"{1e3 * found.mean_speed_deviation:.1f} mm/s, {1e3 * facts['drift_m']:+.0f} ± {1e3 * facts['drift_sd_m']:.0f} "
        f"mm to the left, turned by {facts['turned_deg']:+.0f} degrees; the {found.nose_by} tells where its nose is"
    )
    speed, heading = facts["median_sd"]["speed"], facts["median_sd"]["heading"]
    typer.echo(
        f"  picture by picture: speed ± {1e3 * speed:.1f} mm/s, heading ± {57.29578 * heading:.1f} degrees; "
        f"all lengths ± {100.0 * found.scale_deviation:.1f} % together"
    )
    for warning in one.warnings():
        typer.echo(f"  warning: {warning}", err=True)

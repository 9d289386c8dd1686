//! Pictures encoded by the real ffmpeg, and decoded again by it.

use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use forelight_renderer::door::{Limits, RendererError, Run};
use forelight_renderer::picture_name;
use forelight_test_needs::not_run;
use forelight_video::Encoder;
use image::{Rgb, RgbImage};
use serde_json::Value;
use tempfile::TempDir;

const SIZE: (u32, u32) = (33, 17);
const FRAMES: usize = 5;

fn encoder() -> Option<Encoder> {
    Encoder::find().inspect_err(|reason| not_run(reason)).ok()
}

/// The colour of all pixels of a frame.
fn color(frame: usize) -> [u8; 3] {
    [[200, 30, 30], [30, 200, 30], [30, 30, 200], [120, 120, 120], [240, 230, 20]][frame]
}

fn pictures() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for frame in 0..FRAMES {
        let picture = RgbImage::from_pixel(SIZE.0, SIZE.1, Rgb(color(frame)));
        picture.save(folder.path().join(picture_name(frame))).unwrap();
    }
    folder
}

/// Encodes the pictures of a folder. Returns the video, what was logged, and the last progress.
fn encoded(encoder: &Encoder, pictures: &Path) -> Result<(Vec<u8>, Vec<String>, f64), RendererError> {
    let scratch = tempfile::tempdir().unwrap();
    let (cancelled, progress, lines) = (AtomicBool::new(false), Mutex::new(0.0), Mutex::new(Vec::new()));
    let run = Run {
        progress: &|share| *progress.lock().unwrap() = share,
        log: &|line| lines.lock().unwrap().push(line.to_owned()),
        ..Run::silent(&cancelled, scratch.path(), Limits::default())
    };
    let video = encoder.encode((pictures, FRAMES), "23.976".parse().unwrap(), &run)?;
    assert!(video.usage.cpu_nanos > 0 && video.usage.peak_memory_bytes > 0);
    let content = std::fs::read(video.path).unwrap();
    Ok((content, lines.into_inner().unwrap(), progress.into_inner().unwrap()))
}

/// What ffprobe says of the video's only stream.
fn stream(video: &Path) -> Value {
    let entries = ["-v", "error", "-count_frames", "-show_streams", "-of", "json"];
    let said = Command::new("ffprobe").args(entries).arg(video).output().unwrap();
    let mut document: Value = serde_json::from_slice(&said.stdout).unwrap();
    assert_eq!(document["streams"].as_array().unwrap().len(), 1);
    document["streams"][0].take()
}

#[test]
fn the_video_shows_the_pictures_in_order_at_their_rate() {
    let Some(encoder) = encoder() else { return };
    let pictures = pictures();
    let (content, lines, progress) = encoded(&encoder, pictures.path()).unwrap();
    assert_eq!((lines, progress), (Vec::new(), 1.0));
    let video = pictures.path().join("video.mp4");
    std::fs::write(&video, &content).unwrap();
    let stream = stream(&video);
    for (name, expected) in [
        ("codec_name", "h264"),
        ("pix_fmt", "yuv420p"),
        ("r_frame_rate", "24000/1001"),
        ("nb_read_frames", "5"),
        ("color_space", "bt709"),
        ("color_transfer", "iec61966-2-1"),
    ] {
        assert_eq!(stream[name], expected, "{name}");
    }
    // Odd sizes are made even.
    assert_eq!((stream["width"].as_u64(), stream["height"].as_u64()), (Some(34), Some(18)));
    let decoded = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(&video)
        .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "pipe:1"])
        .output()
        .unwrap();
    let bytes_of_frame = 34 * 18 * 3;
    assert_eq!(decoded.stdout.len(), FRAMES * bytes_of_frame);
    for (frame, content) in decoded.stdout.chunks_exact(bytes_of_frame).enumerate() {
        let middle = &content[(8 * 34 + 16) * 3..][..3];
        for (channel, (found, shown)) in middle.iter().zip(color(frame)).enumerate() {
            let difference = i16::from(*found) - i16::from(shown);
            // In the colours of another standard, some channels would be off by 16 and more.
            assert!(difference.abs() <= 8, "frame {frame}, channel {channel}: {found} instead of {shown}");
        }
    }
}

#[test]
fn the_same_pictures_give_the_same_file() {
    let Some(encoder) = encoder() else { return };
    let pictures = pictures();
    let [first, second] = [(); 2].map(|()| encoded(&encoder, pictures.path()).unwrap().0);
    assert!(first == second);
}

#[test]
fn missing_and_damaged_pictures_are_named() {
    let Some(encoder) = encoder() else { return };
    let pictures = pictures();
    let third = pictures.path().join(picture_name(2));
    std::fs::write(&third, b"\x89PNG\r\n\x1a\n no picture").unwrap();
    let error = encoded(&encoder, pictures.path()).unwrap_err();
    assert!(matches!(error, RendererError::Ended { .. }) && error.to_string().contains("png"), "{error}");
    std::fs::remove_file(&third).unwrap();
    let error = encoded(&encoder, pictures.path()).unwrap_err();
    assert!(error.to_string().contains("000002.png"), "{error}");
}

#[test]
fn a_program_that_is_no_ffmpeg_is_refused_with_what_to_do() {
    for (program, reason) in [("/no/such/ffmpeg", "install ffmpeg"), ("true", "does not say its version")] {
        let error = Encoder::at(program).unwrap_err().to_string();
        assert!(error.contains(reason) && error.contains("FORELIGHT_FFMPEG"), "{error}");
    }
}

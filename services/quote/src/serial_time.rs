//! How long a frame keeps its node beyond its CPU time divided by the node's cores.
//!
//! Renderers load and prepare scenes on one core, files are transferred, programs wait for disks and licences.
//! CPU time does not show that. On a node of many cores, it is most of the time of a short frame.
//!
//! It is learnt from finished frames. Until some of the job's own are finished, those of the renderer's last
//! jobs stand in. A job with shorter frames takes over a smaller part: what took time in proportion to long
//! frames does so in short ones.

/// Frames of the job that weigh as much as what the renderer's other jobs say.
const WEIGHT_OF_PAST: i64 = 3;

/// Serial time counts if it differs from what plans use by more than this share of a frame's time.
const NEWS: f64 = 0.1;

/// No single frame says more than this: twice the time that one core needs, and ten minutes. It may have hung.
const MOST_TIMES: f64 = 2.0;
const TEN_MINUTES: i64 = 600_000_000;

/// Finished frames of a job on nodes with one core, or with several. Sums, in microseconds.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct NodeUse {
    /// Number of frames.
    pub frames: i64,
    /// CPU time on a node of speed 1.
    pub cpu: i64,
    /// CPU time on their nodes, divided by the nodes' cores.
    pub shared: i64,
    /// Time for which they kept their nodes.
    pub used: i64,
}

impl NodeUse {
    /// Of one frame that took so many CPU seconds on a node with so many cores, and that are `at_speed_one` on
    /// a node of speed 1. It kept the node for `used` microseconds.
    pub fn of_frame(seconds: f64, at_speed_one: f64, cores: u32, used: i64) -> Self {
        let micros = |seconds: f64| (seconds.max(0.0) * 1e6) as i64;
        let shared = micros(seconds / f64::from(cores.max(1)));
        let most = micros(seconds * MOST_TIMES).saturating_add(TEN_MINUTES);
        Self { frames: 1, cpu: micros(at_speed_one), shared, used: used.clamp(0, most) }
    }

    fn serial(&self) -> i64 {
        self.used.saturating_sub(self.shared)
    }
}

/// Serial time of a frame, in microseconds.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct SerialTime {
    /// On nodes of one core.
    pub one_core: i64,
    /// On nodes of several cores.
    pub many_cores: i64,
}

impl SerialTime {
    /// What finished frames of the job teach, and those of the renderer's last jobs. Each pair is of nodes with
    /// one core and with several. `frame_cpu` is the mean CPU time of the job's frames on a node of speed 1, in
    /// microseconds.
    pub fn learnt(own: [NodeUse; 2], past: &[[NodeUse; 2]], frame_cpu: i64) -> Self {
        let [one_core, many_cores] = [0, 1].map(|kind| {
            let of_past = past.iter().map(|job| job[kind]).filter(|job| job.frames > 0);
            let (mut sum, mut jobs) = (0i128, 0i128);
            for job in of_past {
                let cpu = i128::from(job.cpu.max(1));
                let all = i128::from(frame_cpu.max(0)) * i128::from(job.frames);
                sum += i128::from(job.serial()) * all.min(cpu) / cpu / i128::from(job.frames);
                jobs += 1;
            }
            let weight = if jobs == 0 { 0 } else { i128::from(WEIGHT_OF_PAST) };
            let frames = weight + i128::from(own[kind].frames);
            if frames == 0 {
                return 0;
            }
            let mean = (sum / jobs.max(1) * weight + i128::from(own[kind].serial())) / frames;
            i64::try_from(mean.max(0)).unwrap_or(i64::MAX)
        });
        Self { one_core, many_cores }
    }

    /// That on a node with so many cores.
    pub fn on(&self, cores: u32) -> i64 {
        if cores > 1 { self.many_cores } else { self.one_core }
    }

    /// Whether plans should use this in place of `before`, after frames with such a use of their nodes.
    pub fn is_news(&self, before: &SerialTime, own: [NodeUse; 2]) -> bool {
        let differs = |now: i64, before: i64, own: NodeUse| {
            let frame = own.shared / own.frames.max(1);
            own.frames > 0 && now.abs_diff(before) as f64 > NEWS * frame.saturating_add(before) as f64
        };
        differs(self.one_core, before.one_core, own[0]) || differs(self.many_cores, before.many_cores, own[1])
    }
}

/// Whether a finished frame is a reason to look again at what frames teach: less and less often.
pub fn is_due(frames: i64) -> bool {
    frames.count_ones() == 1 || frames % 32 == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000;

    /// So many frames of so many CPU seconds on eight cores, each with so many seconds of serial time.
    fn frames(frames: i64, cpu: i64, serial: i64) -> [NodeUse; 2] {
        let shared = frames * cpu * SECOND / 8;
        let used = shared + frames * serial * SECOND;
        [NodeUse::default(), NodeUse { frames, cpu: frames * cpu * SECOND, shared, used }]
    }

    fn learnt(own: [NodeUse; 2], past: &[[NodeUse; 2]], cpu: i64) -> i64 {
        let found = SerialTime::learnt(own, past, cpu * SECOND);
        assert_eq!(found.one_core, 0, "nothing is known of nodes with one core");
        found.many_cores
    }

    #[test]
    fn a_frame_says_how_long_it_kept_its_node_and_not_without_bound() {
        let seen = NodeUse::of_frame(80.0, 40.0, 8, 13 * SECOND);
        assert_eq!(seen, NodeUse { frames: 1, cpu: 40 * SECOND, shared: 10 * SECOND, used: 13 * SECOND });
        assert_eq!(NodeUse::of_frame(80.0, 40.0, 8, 1000 * SECOND).used, 760 * SECOND);
        assert_eq!(NodeUse::of_frame(f64::NAN, -1.0, 0, -5), NodeUse { frames: 1, ..NodeUse::default() });
    }

    #[test]
    fn frames_of_the_job_outweigh_other_jobs_more_and_more() {
        let none = frames(0, 0, 0);
        assert_eq!(learnt(none, &[], 80), 0);
        assert_eq!(learnt(frames(1, 80, 3), &[], 80), 3 * SECOND);
        let past = [frames(10, 80, 6), frames(100, 80, 2)];
        assert_eq!(learnt(none, &past, 80), 4 * SECOND, "each job counts once");
        assert_eq!(learnt(frames(3, 80, 1), &past, 80), (4 * 3 + 3) * SECOND / 6);
        assert!(learnt(frames(1000, 80, 1), &past, 80) < 101 * SECOND / 100);
        // Nodes that are faster than they say leave nothing.
        assert_eq!(learnt(frames(2, 80, -1), &[], 80), 0);
    }

    #[test]
    fn shorter_frames_take_over_a_part_and_longer_ones_no_more() {
        let past = [frames(10, 80, 6)];
        let none = frames(0, 0, 0);
        assert_eq!(learnt(none, &past, 20), 6 * SECOND / 4);
        assert_eq!(learnt(none, &past, 8000), 6 * SECOND);
        assert_eq!(learnt(none, &past, 0), 0);
    }

    #[test]
    fn a_tenth_of_a_frames_time_is_news() {
        let own = frames(4, 80, 2);
        let of = |many_cores| SerialTime { one_core: 0, many_cores };
        assert!(of(2 * SECOND).is_news(&of(0), own));
        assert!(!of(SECOND).is_news(&of(0), own));
        assert!(!of(2 * SECOND).is_news(&of(0), frames(0, 0, 0)), "without frames there is no news");
        let due: Vec<i64> = (1..=70).filter(|&frames| is_due(frames)).collect();
        assert_eq!(due, [1, 2, 4, 8, 16, 32, 64]);
        assert!(is_due(96));
    }

    #[test]
    fn sums_without_bound_do_not_overflow() {
        let huge = NodeUse { frames: 1, cpu: i64::MAX, shared: 0, used: i64::MAX };
        let found = SerialTime::learnt([huge; 2], &[[huge; 2]; 20], i64::MAX);
        assert_eq!(found.on(1), i64::MAX);
        assert_eq!(found.on(64), i64::MAX);
    }
}

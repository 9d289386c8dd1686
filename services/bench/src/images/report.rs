use super::measured::{Measured, MeasuredPeer};
use crate::report::{Report, share};
use forelight_terminal::quantities::{count, percent, seconds};
use forelight_terminal::table::{Align, Table};

pub fn of(measured: &Measured) -> Report {
    let Measured { bundle, size, ambient_bounces, threads, reference, .. } = measured;
    let mut report = Report::default().text(format!(
        "{bundle}, {size} x {size}, {ambient_bounces} bounces, {threads} threads; converged: {}\n\n",
        reference.flags,
    ));
    report = report.table(rungs(measured));
    if let Some(gathered) = &reference.gathered {
        report = report.text(format!(
            "\nindirect: against {} on the same camera samples, whose own noise is at most {}\n",
            gathered.flags,
            share(gathered.noise)
        ));
    }
    if !measured.cached.is_empty() {
        report = report.text("\n").table(cached(measured));
    }
    for speed_up in &measured.second_thread {
        report = report.text(format!(
            "\na second thread: {:.2} times as fast ({:.2} to {:.2}), {}",
            speed_up.ratio, speed_up.lowest, speed_up.highest, speed_up.flags
        ));
    }
    report = report.text("\n");
    if !measured.peers.is_empty() {
        report = report.text("\n").table(peers(&measured.peers));
    }
    report.text("\n")
}

fn rungs(measured: &Measured) -> Table {
    let mut table = Table::new(&[
        ("settings", Align::Left),
        ("error", Align::Right),
        ("lit", Align::Right),
        ("bias", Align::Right),
        ("indirect", Align::Right),
        ("work", Align::Right),
        ("plan", Align::Right),
        ("fill", Align::Right),
        ("records", Align::Right),
        ("CPU", Align::Right),
        ("spread", Align::Right),
    ]);
    for rung in &measured.rungs {
        let of_cache = |text: String| if rung.cached { text } else { String::new() };
        table.row([
            rung.flags.clone(),
            share(rung.error.rmse),
            share(rung.error.lit),
            format!("{:+.2} %", rung.error.bias * 100.0),
            rung.indirect_error.map_or(String::new(), |distance| share(distance.rmse)),
            count(rung.work as f64),
            of_cache(format!("{:.0} %", rung.plan_share * 100.0)),
            of_cache(format!("{:.0} %", rung.fill_share * 100.0)),
            of_cache(count(rung.records.iter().sum::<u64>() as f64)),
            seconds(rung.cpu_seconds),
            percent(rung.cpu_spread),
        ]);
    }
    table
}

fn cached(measured: &Measured) -> Table {
    let mut table = Table::new(&[
        ("cached, against gathering at an equal error", Align::Left),
        ("indirect", Align::Right),
        ("work", Align::Right),
        ("CPU", Align::Right),
    ]);
    for saved in &measured.cached {
        table.row([
            saved.flags.clone(),
            share(saved.error),
            times(saved.work, ""),
            times(saved.cpu_seconds, ""),
        ]);
    }
    table
}

fn peers(peers: &[MeasuredPeer]) -> Table {
    let mut table = Table::new(&[
        ("other programs", Align::Left),
        ("error", Align::Right),
        ("lit", Align::Right),
        ("CPU", Align::Right),
        ("of ours", Align::Right),
        ("lit", Align::Right),
        ("converged against ours", Align::Right),
    ]);
    for peer in peers {
        let least = if peer.bound { "> " } else { "" };
        table.row([
            peer.name.clone(),
            share(peer.error.rmse),
            share(peer.error.lit),
            seconds(peer.cpu_seconds),
            times(peer.ratio, least),
            times(peer.ratio_lit, least),
            peer.reference.map_or(String::new(), |d| format!("{} {:+.2} %", share(d.lit), d.bias * 100.0)),
        ]);
    }
    table
}

/// `12.3 x`, or a dash if unknown.
fn times(ratio: Option<f64>, least: &str) -> String {
    ratio.map_or("-".into(), |ratio| format!("{least}{ratio:.1} x"))
}

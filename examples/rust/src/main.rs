//! Prints position, attitude and standard deviation of every vehicle that publishes on this machine.
//!
//!     cargo run -- tcp/127.0.0.1:7447
use companion::NavState;
use prost::Message;
use zenoh::Wait;

#[allow(dead_code)] // the file holds more messages than this one
mod companion {
    include!(concat!(env!("OUT_DIR"), "/companion.rs"));
}

fn main() -> zenoh::Result<()> {
    let endpoint = std::env::args().nth(1).unwrap_or("tcp/127.0.0.1:7447".into());
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"client\"")?;
    config.insert_json5("connect/endpoints", &format!("[{endpoint:?}]"))?;
    let session = zenoh::open(config).wait()?;
    let states = session.declare_subscriber("companion/*/nav/state").wait()?;
    while let Ok(sample) = states.recv() {
        let state = NavState::decode(&*sample.payload().to_bytes())?;
        println!(
            "{} {:.7} {:.7} {:.2} m, yaw {:.1} deg, sd {:.2} m, {:?}",
            sample.key_expr(), state.lat.to_degrees(), state.lon.to_degrees(), state.height,
            state.yaw_deg, state.sd_pos_m[0].hypot(state.sd_pos_m[1]), state.mode()
        );
    }
    Ok(())
}

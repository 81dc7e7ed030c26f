import java.math.BigDecimal;
import java.nio.charset.StandardCharsets;
import java.nio.file.Files;
import java.util.List;
import org.openapitools.client.ApiClient;
import org.openapitools.client.ApiException;
import org.openapitools.client.api.*;
import org.openapitools.client.api.LotsApi.*;
import org.openapitools.client.api.ParticlesApi.*;
import org.openapitools.client.api.ResultsApi.*;
import org.openapitools.client.model.*;

/** Makes the calls of a client that openapi-generator made; the argument is the daemon's address. */
public class Calls {
    public static void main(String[] arguments) throws Exception {
        ApiClient client = new ApiClient();
        client.updateBaseUri(arguments[0]);
        ResultsApi results = new ResultsApi(client);
        ParticlesApi particles = new ParticlesApi(client);
        LotsApi lots = new LotsApi(client);

        List<Result> items = results.results(APIResultsRequest.newBuilder().after(0L).build()).getItems();
        assert items.get(0).getOutcome() == Result.OutcomeEnum.MEASURED && items.size() == 3;
        Result lean = results.results(APIResultsRequest.newBuilder().after(0L).limit(1L).fields("lean").build())
            .getItems().get(0);
        assert lean.getSieveSizeMm().doubleValue() == 10.0;
        assert particles.particle("1").getId().equals(lean.getId());
        assert particles.particles(APIParticlesRequest.newBuilder().outcome("measured").build()).getItems().size() == 1;
        assert text(particles.meshFile("1", MeshFormat.PLY)).startsWith("ply");
        assert text(particles.preview("1")).startsWith("\u0089PNG");
        assert new HealthApi(client).health().getReady();
        assert new AccountingApi(client).accounting("current").getSession() == 1;
        assert results.parkCursor(
            APIParkCursorRequest.newBuilder().name("mes").cursor(new Cursor().after(2L)).build()).getUnread() == 1;

        Apertures sieves = new Apertures();
        sieves.addAll(List.of(new BigDecimal(4), new BigDecimal(8), new BigDecimal(16)));
        ProductRequest product =
            new ProductRequest().title("own sieves").densityKgM3(new BigDecimal(2850)).sieveSet(new SieveSet(sieves));
        assert lots.putProduct(APIPutProductRequest.newBuilder().product("own").productRequest(product).build())
            .getSieveSet().getApertures().size() == 3;
        assert lots.product(APIProductRequest.newBuilder().product("basalt-8-16").build())
            .getSieveSet().getString().equals("en-basic-2");
        assert lots.postClose(APIPostCloseRequest.newBuilder().lot("L2").closeRequest(new CloseRequest()).build())
            .getState() == LotState.CLOSED;
        APIPostLotRequest open = APIPostLotRequest.newBuilder()
            .lotRequest(new LotRequest().lot("L3").product("own")).idempotencyKey("one").build();
        LotDocument opened = lots.postLot(open);
        assert lots.postLot(open).equals(opened);
        assert lots.listLots(APIListLotsRequest.newBuilder().build()).getItems().size() == 3;
        assert text(lots.reportFile(
            APIReportFileRequest.newBuilder().lot("L1").reportFormat(ReportFormat.PDF).build())).startsWith("%PDF");
        try {
            lots.getLot("L9");
            assert false;
        } catch (ApiException error) {
            assert error.getCode() == 404 && error.getResponseBody().contains("urn:stonefall:problem:unknown-lot");
        }
        System.out.println("all calls were answered as described");
    }

    private static String text(java.io.File file) throws java.io.IOException {
        return new String(Files.readAllBytes(file.toPath()), StandardCharsets.ISO_8859_1);
    }
}
